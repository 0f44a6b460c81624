"""The memory that something takes, where it reads what it cannot trust."""

from __future__ import annotations

import tracemalloc
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def taking_less_than(size: int) -> Iterator[None]:
    """Check that at no time the objects made meanwhile take `size` bytes."""
    tracemalloc.start()
    try:
        yield
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < size, f"{peak} bytes were taken"
