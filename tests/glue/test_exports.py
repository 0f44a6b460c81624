"""The names that `glue` exports: imported on first use, not before."""

from __future__ import annotations

import subprocess
import sys

import pytest

import glue


@pytest.mark.parametrize("name", glue.__all__)
def test_every_name_is_there(name: str) -> None:
    assert getattr(glue, name) is not None
    assert name in dir(glue)


def test_import_of_glue_imports_nothing_slow() -> None:
    program = (
        "import glue, sys; print(*(name for name in ('numpy', 'zmq', 'msgpack') if name in sys.modules))"
    )
    shown = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert shown.stdout == "\n"


def test_unknown_name_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="no attribute 'loca'"):
        _ = glue.loca
