"""The pages name what is there: links, folders, extras, modules, tests."""

from __future__ import annotations

import json
import re
import tomllib
from importlib import import_module
from pathlib import Path
from typing import Final

import pytest

from tests.pages import DOCS, PAGES, ROOT, dangling, rows

SECURITY: Final = (DOCS / "security.md").read_text("utf-8")
ARCHITECTURE: Final = (DOCS / "architecture.md").read_text("utf-8")
INSTALL: Final = (DOCS / "install.md").read_text("utf-8")
STABILITY: Final = (DOCS / "stability.md").read_text("utf-8")

PUBLIC: Final = set(re.findall(r"`(glue\.[a-z.]+)`", STABILITY.partition("console commands")[0]))


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_links_lead_somewhere(page: Path) -> None:
    assert dangling(page) == []


def test_folders_and_files_of_the_architecture_are_there() -> None:
    named = set(
        re.findall(r"\b(?:glue|env_server|agents|experiment_runner|tests)/[\w/]*(?:\.py)?", ARCHITECTURE)
    )
    assert len(named) > 30
    assert [name for name in sorted(named) if not (ROOT / name).exists()] == []


def test_every_extra_that_is_for_users_is_listed_once() -> None:
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]["optional-dependencies"]
    listed = [name for row in rows(INSTALL, "| extra |") for name in re.findall(r"`(\w+)`", row[0])]
    assert sorted(listed) == sorted(extras.keys() - {"bench", "dev", "docs"})


def test_every_test_that_names_a_threat_exists_and_every_threat_names_one() -> None:
    tests = (path.read_text("utf-8") for path in (ROOT / "tests").rglob("test_*.py"))
    defined = {
        name for text in tests for name in re.findall(r"^(?:async )?def (test_\w+)", text, re.MULTILINE)
    }
    named = set(re.findall(r"\btest_\w+\b(?!\.py)", SECURITY))
    assert len(named) > 40
    assert named - defined == set()
    tables = re.findall(r"^\|[^\n]*tried by \|\n\|[^\n]*\n((?:\|[^\n]*\n)+)", SECURITY, re.MULTILINE)
    assert len(tables) >= 4
    threats = [row for table in tables for row in table.splitlines()]
    assert [row for row in threats if "test_" not in row and "python -m tests" not in row] == []


def test_documented_programs_import_public_modules_only() -> None:
    texts = {path: path.read_text("utf-8") for path in (*PAGES, *DOCS.glob("examples/python/**/*.py"))}
    for path in DOCS.glob("notebooks/*.ipynb"):
        cells = json.loads(path.read_text("utf-8"))["cells"]
        texts[path] = "\n".join(line for cell in cells for line in cell["source"])
    private = {
        f"{path}: {module}"
        for path, text in texts.items()
        for module in re.findall(r"^\s*(?:from|import) (glue\.[\w.]+)", text, re.MULTILINE)
        if not any(module == public or module.startswith(f"{public}.") for public in PUBLIC)
    }
    assert private == set()


def test_public_modules_exist() -> None:
    assert len(PUBLIC) > 3
    for name in PUBLIC:
        import_module(name)
