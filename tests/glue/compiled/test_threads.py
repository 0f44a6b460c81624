"""Threads that take turns in compiled code: they end, fail and are garbage-collected like any other."""

from __future__ import annotations

import gc
import os
import subprocess
import sys
import threading
import time

import numpy as np
import numpy.typing as npt
import pytest

from glue.compiled.jit import entry
from glue.compiled.threads import CALLER, RELEASED, Gate, Threads, begin_turn, claim, end_turn
from glue.system import clock
from tests.house.imports import ROOT

COUNT = 10
Numbers = npt.NDArray[np.int64]


@entry
def mark(gate: Gate, worker: int, numbers: Numbers) -> None:
    while begin_turn(gate, worker):
        first, last = claim(gate, worker)
        while first < last:
            for i in range(first, last):
                numbers[i] += 1
            first, last = claim(gate, worker)
        if end_turn(gate, worker):
            return


def at_work() -> int:
    return sum(thread.name == "worker" for thread in threading.enumerate())


@pytest.mark.parametrize("count", [1, 2, 3, 2 * COUNT])
def test_each_item_is_done_once_a_turn(count: int) -> None:
    before = at_work()
    threads, numbers = Threads(count, COUNT), np.zeros(COUNT, np.int64)
    for _ in range(1000):
        threads.run(mark, numbers)
    assert numbers.tolist() == [1000] * COUNT
    assert at_work() == before + count - 1
    threads.close()
    assert at_work() == before
    threads.run(mark, numbers)  # by the calling thread
    assert numbers.tolist() == [1001] * COUNT
    threads.close()


def test_the_caller_waits_for_no_worker_that_has_not_begun() -> None:
    def late(gate: Gate, worker: int, numbers: Numbers) -> None:
        if worker == CALLER:
            mark(gate, worker, numbers)
        else:
            begun.wait(60)
            mark(gate, worker, numbers)

    begun = threading.Event()
    threads, numbers = Threads(3, COUNT), np.zeros(COUNT, np.int64)
    for _ in range(10):
        threads.run(late, numbers)
    assert numbers.tolist() == [10] * COUNT
    begun.set()
    threads.close()


def test_workers_claim_what_the_caller_leaves() -> None:
    def leave(gate: Gate, worker: int, numbers: Numbers) -> None:
        if worker != CALLER:
            mark(gate, worker, numbers)
            return
        begin_turn(gate, worker)
        deadline = time.monotonic() + 60
        while gate[CALLER, RELEASED] and not numbers.all() and time.monotonic() < deadline:
            time.sleep(0.001)
        end_turn(gate, worker)

    threads, numbers = Threads(3, COUNT), np.zeros(COUNT, np.int64)
    threads.run(leave, numbers)
    assert numbers.tolist() == [1] * COUNT
    threads.close()


@pytest.mark.parametrize(
    ("work", "read", "pays"),
    [
        ((0.5, 0.5), 0.0, (True, True)),
        ((0.95, 0.95), 0.0, (False, False)),
        ((0.5, 0.5), 1.0, (False, False)),
        ((0.5, 2.0), 0.0, (True, False)),
    ],
    ids=["half the time", "hardly faster", "what other cores wrote is read slowly", "they become slow"],
)
def test_threads_work_together_only_where_trials_show_that_it_pays(
    monkeypatch: pytest.MonkeyPatch, work: tuple[float, float], read: float, pays: tuple[bool, bool]
) -> None:
    """A turn takes the caller alone 2 ms; `work`, at first and from turn 100 on, and `read` are shares."""
    now, together = [0.0], [False]
    monkeypatch.setattr(clock, "monotonic", lambda: now[0])

    def timed(gate: Gate, worker: int, numbers: Numbers) -> None:
        if worker == CALLER:
            together.append(bool(gate[CALLER, RELEASED]))
            now[0] += 0.002 * (work[len(together) >= 100] if together[-1] else 1)
        mark(gate, worker, numbers)

    def reading() -> None:
        now[0] += 0.002 * read * together[-1]

    threads, numbers = Threads(2, COUNT), np.zeros(COUNT, np.int64)
    for _ in range(200):
        threads.run(timed, numbers, then=reading)
    threads.close()
    assert set(together[50:100]) == {pays[0]}
    assert set(together[125:]) == {pays[1]}, "within two trials"


def test_threads_that_nobody_closes_end_when_they_are_forgotten() -> None:
    before = set(threading.enumerate())
    threads = Threads(3, COUNT)
    threads.run(mark, np.zeros(COUNT, np.int64))
    new = set(threading.enumerate()) - before
    assert len(new) == 2
    del threads
    gc.collect()
    for thread in new:
        thread.join(60)
        assert not thread.is_alive()


def test_what_a_thread_raises_is_raised_and_nobody_waits_for_it() -> None:
    def broken(gate: Gate, worker: int, numbers: Numbers) -> None:
        if worker == 1:
            raise ValueError("broken")
        mark(gate, worker, numbers)

    def until_it_has_failed() -> None:
        for _ in range(1000):
            threads.run(broken, np.zeros(COUNT, np.int64))

    threads = Threads(3, COUNT)
    for _ in range(2):
        with pytest.raises(ValueError, match="broken"):
            until_it_has_failed()
    threads.close()


@pytest.mark.parametrize(("uncompiled", "workers"), [("0", 2), ("1", 0)])
def test_a_program_ends_although_threads_wait_and_works_uncompiled(uncompiled: str, workers: int) -> None:
    code = (
        f"from {__name__} import *; threads = Threads(3, COUNT); numbers = np.zeros(COUNT, np.int64); "
        "threads.run(mark, numbers); print(at_work(), numbers.min(), numbers.max())"
    )
    command = [sys.executable, "-c", code]
    env = {**os.environ, "NUMBA_DISABLE_JIT": uncompiled}
    done = subprocess.run(
        command, cwd=ROOT, env=env, capture_output=True, text=True, timeout=120, check=False
    )
    assert (done.returncode, done.stdout) == (0, f"{workers} 1 1\n"), done.stderr
