"""Readers of untrusted bytes raise only the package's own errors."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.fuzzing.targets import TARGETS, examples, run

FOUND = sorted((Path(__file__).parent / "found").glob("*-*"))
"""Inputs for which a target once failed."""


@pytest.mark.parametrize("name", TARGETS)
def test_examples_are_read(name: str) -> None:
    for example in examples(name):
        run(name, example)


@pytest.mark.parametrize("name", [name for name in TARGETS if name != "results"])
@settings(max_examples=50, deadline=None)
@given(data=st.binary(max_size=300))
def test_anything_is_read(name: str, data: bytes) -> None:
    run(name, data)


@pytest.mark.parametrize("file", FOUND, ids=lambda file: file.name)
def test_what_failed_once_is_read(file: Path) -> None:
    run(file.name.partition("-")[0], file.read_bytes())
