"""Threads that step games side by side: compiled code runs without the interpreter's lock."""

from __future__ import annotations

import threading
import weakref
from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import Any

import numpy as np

from glue.compiled.turns import CALLER, Gate, end, let_go, make_gate

__all__ = ["Threads"]


class Threads:
    """A number of threads, each with its share of `count` games; the calling thread is one of them.

    Where threads cannot wait for each other in compiled code, it is the only one.
    """

    def __init__(self, threads: int, count: int) -> None:
        made = make_gate(threads - 1) if threads > 1 else None
        self._gate: Gate = np.zeros(1, np.int64)
        self._memory: Any = None
        if made is None:
            threads = 1
        else:
            self._gate, self._memory = made
        bounds = [count * thread // threads for thread in range(threads + 1)]
        self._first, *self._others = pairwise(bounds)
        self._count = count
        self._workers: list[threading.Thread] = []
        self._errors: list[BaseException] = []

    def run(self, function: Callable[..., None], *shared: Any) -> None:
        """Call `function(gate, worker, *shared, first, last)` for every share, and wait until all are done.

        Args:
            function: takes turns; see `glue.compiled.turns`.
            shared: the same in every call.
        """
        if self._others and not self._workers:
            self._start(function, shared)
        if not self._errors:
            function(self._gate, CALLER, *shared, *self._first)
        if self._errors:
            raise self._errors[0]

    def close(self) -> None:
        """End the threads; what is run later is run by the calling thread alone."""
        if self._workers:
            self._leave()
            for worker in self._workers:
                worker.join()
        self._gate, self._first, self._others = np.zeros(1, np.int64), (0, self._count), []
        self._workers.clear()

    def _start(self, function: Callable[..., None], shared: Sequence[Any]) -> None:
        for number, part in enumerate(self._others):
            given = (self._gate, self._memory, self._errors, function, number, *shared, *part)
            self._workers.append(threading.Thread(target=_work, args=given, name="mario", daemon=True))
            self._workers[-1].start()
        # Threads that nobody closes end with this object; at the end of the program they stay asleep.
        self._leave = weakref.finalize(self, end, self._gate)
        self._leave.atexit = False


def _work(
    gate: Gate,
    memory: Any,
    errors: list[BaseException],
    function: Callable[..., None],
    worker: int,
    *given: Any,
) -> None:
    """Take turns until all is over; `memory` is that of the gate, which lives as long."""
    try:
        function(gate, worker, *given)
    except BaseException as error:
        errors.append(error)
        let_go(gate, worker)
