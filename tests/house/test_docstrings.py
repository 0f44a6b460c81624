"""The grammar of docstrings: a constant is named by a noun, a function by a verb and its object."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

from tests.house.imports import ROOT, files, tree

FREE_RELATIVE = re.compile(r"(?:What|Who|Whatever|Return (?:what|who|whatever))\b")
"""Begins a docstring that names its subject by a clause, as in "What comes" or "Return what is left"."""


def docstrings(file: Path) -> Iterator[ast.Constant]:
    """Yield every string that stands as a statement: of a module, class, function, constant or attribute."""
    for node in ast.walk(tree(file)):
        if (
            isinstance(node, ast.Expr)
            and isinstance(node.value, ast.Constant)
            and isinstance(node.value.value, str)
        ):
            yield node.value


def test_docstrings_name_their_subject() -> None:
    tests = (path.relative_to(ROOT) for path in (ROOT / "tests").rglob("*.py"))
    wrong = [
        f"{file}:{text.lineno}: {str(text.value)[:60]}"
        for file in (*files(), *tests)
        for text in docstrings(file)
        if FREE_RELATIVE.match(str(text.value))
    ]
    assert wrong == []
