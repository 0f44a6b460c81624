"""Configuration of all tests: modules such as `tests.players` can be imported; Ctrl-C works.

Modules with slow tests run first, so that the other processes do not wait for one of them at the end. A
module stays in one process (`--dist=loadfile` in the Makefile), which makes once what its tests share.
"""

from __future__ import annotations

import signal
import sys
from pathlib import Path

import pytest
from hypothesis import settings

sys.path.insert(0, str(Path(__file__).parents[1]))

# Where a shell has put us in the background it may have interrupts ignored, and so would all that we start.
signal.signal(signal.SIGINT, signal.default_int_handler)

# No test asserts on time: the first example of a property may have to compile or import.
settings.register_profile("glue", deadline=None)
settings.load_profile("glue")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    slow = {item.path for item in items if item.get_closest_marker("slow") is not None}
    items.sort(key=lambda item: item.path not in slow)
