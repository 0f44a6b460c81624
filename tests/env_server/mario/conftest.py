"""Fixtures of the environment's tests."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from types import ModuleType

import pytest


def _beside(name: str) -> ModuleType:
    """Return a module beside this file, one that is a program too."""
    spec = importlib.util.spec_from_file_location(name, Path(__file__).with_name(f"{name}.py"))
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="session")
def golden_check() -> ModuleType:
    """Plays the recordings of the original."""
    return _beside("golden_check")


@pytest.fixture(scope="session")
def random_play() -> ModuleType:
    """Makes random tasks and plays them."""
    return _beside("random_play")
