"""docs/security.md: each row of its tables of threats names tests, and all of these exist."""

from __future__ import annotations

import re

from tests.house.imports import ROOT

_TEXT = (ROOT / "docs/security.md").read_text(encoding="utf-8")


def test_every_test_that_the_page_names_exists() -> None:
    defined = {
        name
        for path in (ROOT / "tests").rglob("test_*.py")
        for name in re.findall(r"^(?:async )?def (test_\w+)", path.read_text(encoding="utf-8"), re.MULTILINE)
    }
    named = set(re.findall(r"\btest_\w+\b(?!\.py)", _TEXT))
    assert len(named) > 40
    assert named - defined == set()


def test_every_row_of_threats_names_a_test() -> None:
    tables = re.findall(r"^\|[^\n]*tried by \|\n\|[^\n]*\n((?:\|[^\n]*\n)+)", _TEXT, re.MULTILINE)
    assert len(tables) >= 4
    rows = [row for table in tables for row in table.splitlines()]
    assert [row for row in rows if "test_" not in row and "python -m tests" not in row] == []
