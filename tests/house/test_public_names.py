"""Programs in the documentation import only the public modules that docs/stability.md lists."""

from __future__ import annotations

import json
import re
from importlib import import_module

from tests.house.imports import ROOT

DOCS = ROOT / "docs"
LISTED = (DOCS / "stability.md").read_text(encoding="utf-8").partition("console commands")[0]
PUBLIC = set(re.findall(r"`(glue\.[a-z]+)`", LISTED))


def programs() -> dict[str, str]:
    """Return the texts of README, pages, notebooks and examples, by path."""
    texts = {
        str(path.relative_to(ROOT)): path.read_text(encoding="utf-8")
        for path in [ROOT / "README.md", *DOCS.glob("*.md"), *DOCS.glob("examples/python/**/*.py")]
    }
    for path in DOCS.glob("notebooks/*.ipynb"):
        cells = json.loads(path.read_text(encoding="utf-8"))["cells"]
        texts[path.name] = "\n".join(line for cell in cells for line in cell["source"])
    return texts


def test_documented_programs_import_public_modules_only() -> None:
    imported = re.compile(r"^\s*(?:from|import) (glue\.[\w.]+)", re.MULTILINE)
    private = {
        f"{path}: {module}"
        for path, text in programs().items()
        for module in imported.findall(text)
        if not any(module == public or module.startswith(f"{public}.") for public in PUBLIC)
    }
    assert private == set()


def test_public_modules_exist() -> None:
    import glue

    assert len(PUBLIC) > 3
    for name in PUBLIC:
        if not hasattr(glue, name.removeprefix("glue.")):
            import_module(name)
