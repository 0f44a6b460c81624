"""docs/architecture.md and docs/glossary.md say how the program is built."""

from __future__ import annotations

import ast
import re
from pathlib import Path
from typing import Final

import pytest

ROOT: Final = Path(__file__).parents[2]
TEXT: Final = (ROOT / "docs/architecture.md").read_text(encoding="utf-8")


PACKAGES: Final = ("glue", "env_server", "agents", "experiment_runner")


def rows_of_modules(package: str) -> list[list[str]]:
    section = TEXT.partition(f"## Inside `{package}`")[2].partition("\n## ")[0]
    first_cells = re.findall(r"^\| (`.*?) \|", section, re.MULTILINE)
    return [re.findall(r"`([\w.]+)`", cell) for cell in first_cells]


def modules_of(package: str) -> dict[str, Path]:
    files = (ROOT / package).rglob("*.py")
    return {
        ".".join(file.relative_to(ROOT / package).with_suffix("").parts): file
        for file in files
        if file.name != "__init__.py"
    }


ROWS: Final = {module: number for number, row in enumerate(rows_of_modules("glue")) for module in row}


@pytest.mark.parametrize("package", PACKAGES)
def test_every_module_has_a_place_and_every_place_a_module(package: str) -> None:
    placed = [module for row in rows_of_modules(package) for module in row]
    assert sorted(placed) == sorted(modules_of(package))


@pytest.mark.parametrize("module", sorted(ROWS))
def test_module_imports_only_from_its_own_row_and_those_above(module: str) -> None:
    tree = ast.parse(modules_of("glue")[module].read_text(encoding="utf-8"))

    imported = {
        name.removeprefix("glue.")
        for node in ast.walk(tree)
        if isinstance(node, ast.ImportFrom) and node.module
        for name in (node.module, *(f"{node.module}.{alias.name}" for alias in node.names))
        if name.startswith("glue.")
    }

    assert [name for name in imported & ROWS.keys() if ROWS[name] > ROWS[module]] == []


def test_names_in_the_path_of_a_step_exist() -> None:
    section = TEXT.partition("## The path of one step")[2].partition("\n## ")[0]
    named = re.findall(r"`(\w+)\.(\w+)(?:\.(\w+))?`", section)

    assert len(named) >= 5
    for module, name, member in named:
        source = modules_of("glue")[module].read_text(encoding="utf-8")
        assert re.search(rf"^(class|def) {name}\b", source, re.MULTILINE)
        assert not member or f"    def {member}(" in source


@pytest.mark.parametrize("document", ["architecture", "glossary"])
def test_links_lead_somewhere(document: str) -> None:
    for target in re.findall(r"\]\(([^)]+)\)", (ROOT / f"docs/{document}.md").read_text(encoding="utf-8")):
        file, _, anchor = target.partition("#")
        linked = (ROOT / "docs" / file).read_text(encoding="utf-8")
        headings = re.findall(r"^#+ (.*)$", linked, re.MULTILINE)
        assert not anchor or anchor in {heading.lower().replace(" ", "-") for heading in headings}
