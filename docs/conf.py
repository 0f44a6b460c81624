"""How the pages of this folder become a site: `make docs`."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Final

from docutils import nodes
from pygments.lexers.special import TextLexer
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

import glue

ROOT: Final = Path(__file__).parents[1]
SOURCE: Final = "https://github.com/glue-rl/glue-rl/blob/main"

project = "glue-rl"
author = "the glue-rl maintainers"
copyright = author
version = release = glue.__version__

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
exclude_patterns = ["examples"]
html_theme = "furo"
html_title = f"glue-rl {release}"
html_static_path = ["site"]
html_css_files = ["site.css"]
html_theme_options = {"top_of_page_buttons": []}
nitpicky = False
pygments_style = "a11y-high-contrast-light"
pygments_dark_style = "a11y-high-contrast-dark"

myst_enable_extensions = ["colon_fence", "html_image"]
myst_heading_anchors = 4

default_role = "code"
autodoc_member_order = "bysource"
autodoc_typehints = "description"
autodoc_typehints_description_target = "documented"
napoleon_use_rtype = False


class CommandHelp(SphinxDirective):
    """The `--help` of a command, as the terminal shows it."""

    required_arguments = 1
    final_argument_whitespace = True

    def run(self) -> list[nodes.Node]:
        name, *arguments = self.arguments[0].split()
        shown = subprocess.run(
            [Path(sys.executable).parent / name, *arguments],
            env={**os.environ, "COLUMNS": "80", "NO_COLOR": "1"},
            capture_output=True,
            text=True,
            check=True,
        )
        return [nodes.literal_block(shown.stdout, shown.stdout, language="text")]


_LINK: Final = re.compile(r"\]\(((?!\w+:)[^)#\s]+)(#[^)\s]*)?\)")


def link_to_source(app: Sphinx, page: str, source: list[str]) -> None:
    """Let links to files of the repository that are not pages lead to the repository."""

    def replaced(link: re.Match[str]) -> str:
        path = (Path(app.srcdir, page).parent / link[1]).resolve()
        if not path.exists() or (path.is_relative_to(app.srcdir) and path.is_file()):
            return link[0]
        return f"]({SOURCE}/{path.relative_to(ROOT)}{link[2] or ''})"

    source[0] = _LINK.sub(replaced, source[0])


_COMPLETIONS: Final = (
    ('<p class="caption" role="heading">', '<p class="caption" role="heading" aria-level="2">'),
    ("<pre>", '<pre tabindex="0">'),
    ('<div class="table-wrapper', '<div tabindex="0" class="table-wrapper'),
    ('<aside class="sidebar-drawer"', '<aside aria-label="Site" class="sidebar-drawer"'),
    ('<aside class="toc-drawer', '<aside aria-label="Page" class="toc-drawer'),
    ('<div id="search-results">', '<h1>Search</h1><div id="search-results">'),
)

_EMPTY_HEADER: Final = re.compile(r'<th class="head[^"]*"><p></p></th>')


def complete_pages(app: Sphinx, error: Exception | None) -> None:
    """Add what screen readers and keyboards need and the theme leaves out."""
    for path in Path(app.outdir).rglob("*.html"):
        text = path.read_text(encoding="utf-8")
        for old, new in _COMPLETIONS:
            text = text.replace(old, new)
        text = _EMPTY_HEADER.sub("<td></td>", text)
        path.write_text(text, encoding="utf-8")


def setup(app: Sphinx) -> None:
    """Register what this site adds to Sphinx."""
    for language in ("body", "message", "zmtp"):  # the bytes of docs/protocol-reference.md
        app.add_lexer(language, TextLexer)
    app.add_directive("command-help", CommandHelp)
    app.connect("source-read", link_to_source)
    app.connect("build-finished", complete_pages)
