"""Fixtures of the environment's tests."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from types import ModuleType

import pytest


@pytest.fixture(scope="session")
def golden_check() -> ModuleType:
    """The module beside this file, which is a program too."""
    spec = importlib.util.spec_from_file_location("golden_check", Path(__file__).with_name("golden_check.py"))
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module
