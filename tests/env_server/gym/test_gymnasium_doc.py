"""The examples of docs/gymnasium.md have the results that they show."""

from __future__ import annotations

import doctest
from pathlib import Path

import pytest

TEXT = (Path(__file__).parents[3] / "docs" / "gymnasium.md").read_text(encoding="utf-8")


def test_examples_are_what_they_show() -> None:
    pytest.importorskip("gymnasium", reason="needs Gymnasium: the extra gym")
    examples = doctest.DocTestParser().get_doctest(TEXT, {}, "gymnasium.md", None, 0)
    assert doctest.DocTestRunner().run(examples, out=pytest.fail).attempted >= 15
