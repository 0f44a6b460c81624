"""Turns that compiled code takes in several threads: a caller releases its workers, and waits for them.

    while begin_turn(gate, worker):
        ...  # its share of the work
        if end_turn(gate, worker):
            return

A worker stays in its loop from one call to the next, without the interpreter's lock: to wake a thread of
Python's for each call takes longer than many calls do. Whoever waits spins for a moment, and then sleeps
until the other posts a POSIX semaphore.
"""

from __future__ import annotations

import ctypes
from typing import Any, Final

import numpy as np
import numpy.typing as npt
from numba.core import config, types

from glue.compiled.jit import jit

__all__ = ["CALLER", "Gate", "begin_turn", "end", "end_turn", "let_go", "make_gate"]

CALLER: Final = -1
"""The number of the caller, which is no worker."""

Gate = npt.NDArray[np.int64]
"""For each worker the addresses of two semaphores, `go` and `done`; last, whether the workers are to end."""

_SEMAPHORE_BYTES: Final = 128  # at most; and each has cache lines of its own
_SPINS: Final = 60_000
"""Some 300 microseconds: Python needs up to 150 between two calls, and to wake takes about 100."""

_SPINS_IN_A_ROW: Final = 2_000
"""After some 10 microseconds others may have the core: the thread that is waited for may be among them."""


def _semaphore_function(name: str) -> Any:
    return types.ExternalFunction(name, types.int32(types.uintp))


_post = _semaphore_function("sem_post")
_wait = _semaphore_function("sem_wait")
_trywait = _semaphore_function("sem_trywait")
_yield = types.ExternalFunction("sched_yield", types.int32())


def make_gate(workers: int) -> tuple[Gate, npt.NDArray[np.uint8]] | None:
    """Return a gate, and the memory that has to live as long; None where there are no such semaphores."""
    library = ctypes.CDLL(None)
    if config.DISABLE_JIT or not hasattr(library, "sem_init"):  # type: ignore[attr-defined]
        return None
    memory = np.zeros((2 * workers + 1) * _SEMAPHORE_BYTES, np.uint8)
    first = -(-memory.ctypes.data // _SEMAPHORE_BYTES) * _SEMAPHORE_BYTES
    gate = np.zeros(2 * workers + 1, np.int64)
    gate[:-1] = first + np.arange(2 * workers) * _SEMAPHORE_BYTES
    if any(library.sem_init(ctypes.c_void_p(int(address)), 0, 0) for address in gate[:-1]):
        return None
    return gate, memory


def let_go(gate: Gate, worker: int) -> None:
    """Tell the caller, from Python, that a worker is done with its turn."""
    ctypes.CDLL(None).sem_post(ctypes.c_void_p(int(gate[2 * worker + 1])))


def end(gate: Gate) -> None:
    """Let all workers leave their loops."""
    gate[-1] = 1
    for address in gate[:-1:2]:
        ctypes.CDLL(None).sem_post(ctypes.c_void_p(int(address)))


@jit
def begin_turn(gate: Gate, worker: int) -> bool:
    """As the caller, release all workers; as a worker, wait for that. Return False if workers are to end."""
    if worker == CALLER:
        for other in range(len(gate) // 2):
            _post(np.uintp(gate[2 * other]))
        return True
    _await(gate[2 * worker])
    return bool(gate[-1] == 0)


@jit
def end_turn(gate: Gate, worker: int) -> bool:
    """As the caller, wait for all workers, and return True; as a worker, report to the caller."""
    if worker == CALLER:
        for other in range(len(gate) // 2):
            _await(gate[2 * other + 1])
        return True
    _post(np.uintp(gate[2 * worker + 1]))
    return False


@jit
def _await(semaphore: int) -> None:
    for spin in range(1, _SPINS + 1):
        if _trywait(np.uintp(semaphore)) == 0:
            return
        if spin % _SPINS_IN_A_ROW == 0:
            _yield()
    while _wait(np.uintp(semaphore)) != 0:  # a signal came
        pass
