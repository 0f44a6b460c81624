"""Threads that share work in compiled code, which runs without the interpreter's lock.

    @entry
    def double(gate, worker, numbers):
        while begin_turn(gate, worker):
            first, last = claim(gate, worker)
            while first < last:
                numbers[first:last] *= 2
                first, last = claim(gate, worker)
            if end_turn(gate, worker):
                return

    threads = Threads(2, len(numbers))
    threads.run(double, numbers)

A worker stays in its loop from one call to the next, because waking a Python thread for each call takes
longer than many calls do. A waiting thread spins for a moment, and then sleeps until another posts a POSIX
semaphore. Every thread claims pieces of its own share first and then of the others', so the caller does the
work of a worker that does not get a core, and does not wait for it. That is why there is no `prange` here:
beside other work on both cores, many games in two threads of numba's OpenMP reach 1 to 20 % of the speed of
one, these 91 to 116 % (docs/performance.md).
"""

from __future__ import annotations

import ctypes
import sys
import weakref
from collections.abc import Callable, Generator, Sequence
from itertools import pairwise
from typing import Any, Final

import numpy as np
import numpy.typing as npt
from numba.core import cgutils, config, types
from numba.extending import intrinsic

from glue.compiled.jit import jit
from glue.system import clock
from glue.system.threads import Thread

CALLER: Final = 0
"""Number of the calling thread; the workers follow."""

Gate = npt.NDArray[np.int64]
"""A row for each thread; see the columns below."""

_FIRST: Final = 0
"""First item of the thread's share."""
_LAST: Final = 1
"""End of its share."""
_NEXT: Final = 2
"""First unclaimed item of its share."""
_GO: Final = 3
"""Address of the semaphore that releases a worker."""
_DONE: Final = 4
"""Address of the semaphore by which a worker reports."""
RELEASED: Final = 5
"""In the caller's row: workers released in this turn."""
_PIECE: Final = 6
"""In the caller's row: items in a piece, if there are threads to share with."""
_ENDING: Final = 7
"""In the caller's row: whether the workers must leave their loops."""
_SEMAPHORES: Final = 8
"""Room for two semaphores of four words."""
_WORDS: Final = 16
"""Words of a row: two cache lines."""

_PIECES: Final = 8
"""Pieces of a share, so that a late thread leaves most of its share to the others."""
_SPINS: Final = 60_000
"""Spins before sleeping, about 300 us: Python needs up to 150 us between two calls, waking about 100 us."""
_SPINS_IN_A_ROW: Final = 2_000
"""Spins, about 10 microseconds, before yielding the core: the awaited thread may need it."""

_TRIAL: Final = 0.005
"""Minimum duration in seconds of each trial: with all threads, the caller only, and all threads again."""
_CALLS: Final = 3
"""Minimum number of calls in a trial."""
_REST: Final = 0.4
"""Seconds for which the caller works alone after winning a trial; doubled each time that it wins again."""
_LONGEST_REST: Final = 6.4
_ALWAYS: Final = sys.maxsize
_WORTH: Final = 0.9
"""Ratio of all threads' time to the caller's below which they work together: trials are short."""


def _semaphore_function(name: str) -> Any:
    return types.ExternalFunction(name, types.int32(types.uintp))


_post = _semaphore_function("sem_post")
_wait = _semaphore_function("sem_wait")
_trywait = _semaphore_function("sem_trywait")
_yield = types.ExternalFunction("sched_yield", types.int32())


def nothing() -> None:
    """Do nothing after a turn."""


class Threads:
    """A number of threads that share `count` items; the calling thread is one of them.

    They work together while trials show that to be clearly faster than the calling thread alone. Between
    trials, the calling thread alone is as fast as a `Threads` of one.
    Where threads cannot wait for each other in compiled code, the calling thread does all the work.
    """

    def __init__(self, threads: int, count: int) -> None:
        self._gate = _gate(threads, count)
        self._workers: list[Thread] = []
        self._errors: list[BaseException] = []
        self._choices = _choices()
        self._together, self._alone = next(self._choices)
        if len(self._gate) == 1:
            self._alone = _ALWAYS

    def run(self, function: Callable[..., None], *shared: Any, then: Callable[[], None] = nothing) -> None:
        """Call `function(gate, worker, *shared)` in the threads, and `then` when every item is done.

        Args:
            function: claims items; see above.
            shared: further arguments, the same in every call.
            then: reads the results, in the calling thread. Trials include its time, because it is
                longer where another core has written.
        """
        gate = self._gate
        if self._alone:
            self._alone -= 1
            function(gate, CALLER, *shared)
            then()
            return
        if self._together and not self._workers:
            self._start(function, shared)
        gate[CALLER, RELEASED] = len(self._workers) if self._together else 0
        began = clock.monotonic()
        if not self._errors:
            function(gate, CALLER, *shared)
        if self._errors:
            raise self._errors[0]
        then()
        seconds = clock.monotonic() - began
        gate[CALLER, RELEASED] = 0
        self._together, self._alone = self._choices.send(seconds)

    def close(self) -> None:
        """End the workers; the calling thread does the work of later calls."""
        if self._workers:
            self._leave()
            for worker in self._workers:
                worker.join()
        self._gate, self._alone = _gate(1, int(self._gate[-1, _LAST])), _ALWAYS
        self._workers.clear()

    def _start(self, function: Callable[..., None], shared: Sequence[Any]) -> None:
        for worker in range(1, len(self._gate)):
            given = (self._gate, self._errors, function, worker, *shared)
            self._workers.append(Thread(target=_work, args=given, name="worker", daemon=True))
            self._workers[-1].start()
        # Threads that are not closed end with this object; at the end of the program they stay asleep.
        self._leave = weakref.finalize(self, _end, self._gate)
        self._leave.atexit = False


def _gate(threads: int, count: int) -> Gate:
    """Return a gate for so many threads, or for one where compiled code cannot use semaphores."""
    library = ctypes.CDLL(None)
    if config.DISABLE_JIT or not hasattr(library, "sem_init"):  # type: ignore[attr-defined]
        threads = 1
    gate = np.zeros((threads, _WORDS), np.int64)
    gate[:, _FIRST : _LAST + 1] = [*pairwise(count * thread // threads for thread in range(threads + 1))]
    gate[CALLER, _PIECE] = max(1, -(-count // threads // _PIECES))
    for row in gate[1:]:
        row[_GO], row[_DONE] = row.ctypes.data + 8 * np.array([_SEMAPHORES, _SEMAPHORES + 4])
        if any(library.sem_init(ctypes.c_void_p(int(row[one])), 0, 0) for one in (_GO, _DONE)):
            return _gate(1, count)
    return gate


def _end(gate: Gate) -> None:
    """Let all workers leave their loops."""
    gate[CALLER, _ENDING] = 1
    for address in gate[1:, _GO]:
        ctypes.CDLL(None).sem_post(ctypes.c_void_p(int(address)))


def _work(
    gate: Gate, errors: list[BaseException], function: Callable[..., None], worker: int, *shared: Any
) -> None:
    """Take turns until the workers must end, or until an error, which is kept for the caller."""
    try:
        function(gate, worker, *shared)
    except BaseException as error:
        errors.append(error)
        ctypes.CDLL(None).sem_post(ctypes.c_void_p(int(gate[worker, _DONE])))


def _choices() -> Generator[tuple[bool, int], float, None]:
    """Yield whether the threads work together in the next timed call, and the number of calls before it.

    The calling thread makes those calls alone. Receive the seconds that the timed call took.
    """
    rest = _REST
    while True:
        yield True, 0  # wakes the workers
        first = yield from _timed(True)  # the first use of memory is slow
        alone = yield from _timed(False)
        together = min(first, (yield from _timed(True)))
        if together < _WORTH * alone:
            rest = _REST
            while together < _WORTH * alone:
                together = yield from _timed(True)
        else:
            yield False, int(rest / alone)
            rest = min(2 * rest, _LONGEST_REST)


def _timed(together: bool) -> Generator[tuple[bool, int], float, float]:
    """Repeat a choice as long as a trial takes; return the mean seconds of a call."""
    spent, calls = 0.0, 0
    while spent < _TRIAL or calls < _CALLS:
        spent += yield together, 0
        calls += 1
    return spent / calls


@jit
def begin_turn(gate: Gate, worker: int) -> bool:
    """As the caller, release workers; as a worker, wait for that. Return False if workers must end."""
    if worker == CALLER:
        for share in range(len(gate)):
            gate[share, _NEXT] = gate[share, _FIRST]
        for other in range(1, gate[CALLER, RELEASED] + 1):
            _post(np.uintp(gate[other, _GO]))
        return True
    _await(gate[worker, _GO])
    return bool(gate[CALLER, _ENDING] == 0)


@jit
def claim(gate: Gate, worker: int) -> tuple[int, int]:
    """Return the first item and the end of a piece for this thread: (0, 0) if all items are claimed."""
    piece = gate[CALLER, _PIECE] if gate[CALLER, RELEASED] else gate[-1, _LAST]
    for k in range(len(gate)):
        share = (worker + k) % len(gate)
        last = gate[share, _LAST]
        if gate[share, _NEXT] < last:
            first = _fetch_and_add(gate, share, piece)
            if first < last:
                return first, min(first + piece, last)
    return 0, 0


@jit
def end_turn(gate: Gate, worker: int) -> bool:
    """As the caller, wait for all workers that have begun; as a worker, report. Return whether to leave."""
    if worker == CALLER:
        for other in range(1, gate[CALLER, RELEASED] + 1):
            if _trywait(np.uintp(gate[other, _GO])) != 0:  # it has begun; any other is no longer needed
                _await(gate[other, _DONE])
        return True
    _post(np.uintp(gate[worker, _DONE]))
    return False


@jit
def _await(semaphore: int) -> None:
    for spin in range(1, _SPINS + 1):
        if _trywait(np.uintp(semaphore)) == 0:
            return
        if spin % _SPINS_IN_A_ROW == 0:
            _yield()
    while _wait(np.uintp(semaphore)) != 0:  # interrupted by a signal
        pass


if config.DISABLE_JIT:  # type: ignore[attr-defined]

    def _fetch_and_add(gate: Gate, share: int, piece: int) -> int:
        """Claim a piece of a share, with a single thread; return its first item."""
        gate[share, _NEXT] += piece
        return int(gate[share, _NEXT]) - piece

else:

    @intrinsic
    def _fetch_and_add(typing: Any, gate: Any, share: Any, piece: Any) -> Any:
        """Claim a piece of a share in one atomic operation; return its first item."""

        def generate(context: Any, builder: Any, signature: Any, arguments: Sequence[Any]) -> Any:
            array = context.make_array(signature.args[0])(context, builder, arguments[0])
            at = [arguments[1], context.get_constant(types.int64, _NEXT)]
            pointer: Any = cgutils.get_item_pointer
            address = pointer(context, builder, signature.args[0], array, at)
            return builder.atomic_rmw("add", address, arguments[2], "seq_cst")

        return types.int64(gate, types.int64, types.int64), generate
