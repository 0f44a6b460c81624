"""The pages of the documentation: their fenced blocks, tables, links and anchors.

A comment above a block says what tests do with it: `<!-- file: NAME -->` is a file that later commands need,
`<!-- runs in the tests -->` a shell script or a Python program. `follow` does both, in the order of the page.
"""

from __future__ import annotations

import doctest
import os
import re
import subprocess
import sys
from pathlib import Path
from textwrap import dedent
from typing import Final, NamedTuple

import pytest

ROOT: Final = Path(__file__).parents[1]

DOCS: Final = ROOT / "docs"

PAGES: Final = sorted(
    path
    for pattern in ("*.md", "docs/*.md", "docs/[!_]*/*.md", "docker/**/*.md", "clients/*/*.md")
    for path in ROOT.glob(pattern)
)

RUNS: Final = "runs in the tests"

_BLOCK: Final = re.compile(
    r"^(?:<!-- (?P<note>[^\n]*?) -->\n+)?"
    r"(?P<indent> *)```(?P<language>[^`\n]*)\n(?P<body>.*?)^(?P=indent)```$",
    re.MULTILINE | re.DOTALL,
)
_HEADING: Final = re.compile(r"^#+ (.*)$", re.MULTILINE)
_LINK: Final = re.compile(r"\]\((?!\w+:)([^)#\s]*)(?:#([^)\s]*))?\)")


class Block(NamedTuple):
    """A fenced block, with the comment above it, if any."""

    note: str
    language: str
    body: str

    @property
    def file(self) -> str:
        """The name of the file that the block holds, or an empty string."""
        return self.note.removeprefix("file: ") if self.note.startswith("file: ") else ""


def blocks(text: str, *languages: str) -> list[Block]:
    """Return the fenced blocks of a text, of all languages or of some."""
    found = [
        Block(match["note"] or "", match["language"], dedent(match["body"]))
        for match in _BLOCK.finditer(text)
    ]
    return [block for block in found if not languages or block.language in languages]


def follow(text: str, folder: Path, note: str = RUNS) -> str:
    """Write every file of a text and run every block with this note; return what they printed."""
    printed = []
    for block in blocks(text):
        if block.file:
            (folder / block.file).write_text(block.body, encoding="utf-8")
        elif block.note == note:
            printed.append(run_block(block, folder).stdout)
    return "".join(printed)


def run_block(block: Block, folder: Path, timeout: float = 240) -> subprocess.CompletedProcess[str]:
    """Run a script of the shell or of Python, in which each of our commands can be called by its name."""
    interpreter = ["bash", "-euo", "pipefail"] if block.language == "sh" else [sys.executable]
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
    done = subprocess.run(
        [*interpreter, "-c", block.body],
        cwd=folder,
        env=os.environ | {"PATH": path, "PYTHONPATH": "."},
        capture_output=True,
        text=True,
        timeout=timeout,
    )
    assert done.returncode == 0, f"{block.body}\n{done.stdout}\n{done.stderr}"
    return done


def run_examples(text: str) -> int:
    """Run the interpreter sessions of a text, which must show what is printed; return how many lines ran."""
    examples = doctest.DocTestParser().get_doctest(text, {}, "page", None, 0)
    return doctest.DocTestRunner().run(examples, out=pytest.fail).attempted


def section(text: str, title: str) -> str:
    """Return what is below a heading, up to the next one of its level or a higher one."""
    (found,) = re.findall(
        rf"^(#+) {re.escape(title)}\n(.*?)(?=^#{{1,6}} |\Z)", text, re.MULTILINE | re.DOTALL
    )
    return str(found[1])


def rows(text: str, heading: str) -> list[list[str]]:
    """Return the cells of the first table whose head begins with `heading`."""
    lines = text[text.index(heading) :].split("\n\n")[0].splitlines()[2:]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]


def dangling(page: Path) -> list[str]:
    """Return the links of a page, within the repository, that lead nowhere."""
    found = []
    for file, anchor in _LINK.findall(outside_blocks(page)):
        target = page.parent / file if file else page
        if not target.exists() or (anchor and target.suffix == ".md" and anchor not in anchors(target)):
            found.append(f"{file}#{anchor}" if anchor else file)
    return found


def anchors(page: Path) -> set[str]:
    """Return the anchors of a page's headings, as GitHub and the site name them."""
    headings = _HEADING.findall(outside_blocks(page))
    plain = (re.sub(r"\[([^]]*)\]\([^)]*\)", r"\1", heading) for heading in headings)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in plain}


def outside_blocks(page: Path) -> str:
    """Return the text of a page without its fenced blocks."""
    return _BLOCK.sub("", page.read_text(encoding="utf-8"))
