"""Threads that step games side by side: compiled code runs without the interpreter's lock."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise
from typing import Any

__all__ = ["Threads"]


class Threads:
    """A number of threads, each with its share of `count` games; the calling thread is one of them."""

    def __init__(self, threads: int, count: int) -> None:
        bounds = [count * thread // threads for thread in range(threads + 1)]
        self._first, *self._others = pairwise(bounds)
        self._pool = ThreadPoolExecutor(max(1, threads - 1), "mario")

    def run(self, function: Callable[..., None], *shared: Any) -> None:
        """Call `function(*shared, first, last)` for every share, and wait until all are done."""
        waiting = [self._pool.submit(function, *shared, *part) for part in self._others]
        function(*shared, *self._first)
        for one in waiting:
            one.result()

    def close(self) -> None:
        """End the threads."""
        self._pool.shutdown()
