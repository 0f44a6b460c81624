"""Configuration of all tests: makes modules such as `tests.players` importable, and Ctrl-C work.

Modules with slow tests run first, so that the other processes do not wait for one of them at the end. All
tests of a module run in one process (`--dist=loadfile` in the Makefile), which creates shared objects once.
"""

from __future__ import annotations

import os
import signal
import sys
from pathlib import Path

import pytest
from hypothesis import settings

sys.path.insert(0, str(Path(__file__).parents[1]))

# A shell may start background jobs with interrupts ignored, and every process that we start inherits that.
signal.signal(signal.SIGINT, signal.default_int_handler)

# NumPy's linear algebra starts a thread for each core: a tenth of a second in every process of a test.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

# No test asserts timing: the first example of a property may have to compile or import.
settings.register_profile("glue", deadline=None)
settings.load_profile("glue")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    slow = {item.path for item in items if item.get_closest_marker("slow") is not None}
    items.sort(key=lambda item: item.path not in slow)
