"""Threads that take turns in compiled code: they end, fail and are forgotten like any other."""

from __future__ import annotations

import gc
import subprocess
import sys
import threading

import numpy as np
import numpy.typing as npt
import pytest

from env_server.mario.threads import Threads
from glue.compiled.jit import entry
from glue.compiled.turns import Gate, begin_turn, end_turn
from tests.house.imports import ROOT

COUNT = 10
Numbers = npt.NDArray[np.int64]


@entry
def mark(gate: Gate, worker: int, numbers: Numbers, first: int, last: int) -> None:
    while begin_turn(gate, worker):
        for i in range(first, last):
            numbers[i] += 100 * (worker + 1) + 1
        if end_turn(gate, worker):
            return


def at_work() -> int:
    return sum(thread.name == "mario" for thread in threading.enumerate())


@pytest.mark.parametrize("count", [2, 3])
def test_each_share_is_done_once_a_turn_by_its_own_thread(count: int) -> None:
    before = at_work()
    threads, numbers = Threads(count, COUNT), np.zeros(COUNT, np.int64)
    for _ in range(1000):
        threads.run(mark, numbers)
    owners = [sum(i >= COUNT * one // count for one in range(1, count)) for i in range(COUNT)]
    assert numbers.tolist() == [1000 * (100 * owner + 1) for owner in owners]
    assert at_work() == before + count - 1
    threads.close()
    assert at_work() == before
    threads.run(mark, numbers)  # by the calling thread alone
    assert numbers.tolist() == [1000 * (100 * owner + 1) + 1 for owner in owners]
    threads.close()


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
    def broken(gate: Gate, worker: int, first: int, last: int) -> None:
        begin_turn(gate, worker)
        if worker == 1:
            raise ValueError("broken")
        end_turn(gate, worker)

    threads = Threads(3, COUNT)
    for _ in range(2):
        with pytest.raises(ValueError, match="broken"):
            threads.run(broken)
    threads.close()


def test_a_program_ends_although_threads_wait() -> None:
    code = (
        f"from {__name__} import *; threads = Threads(3, COUNT); "
        "threads.run(mark, np.zeros(COUNT, np.int64)); print(at_work())"
    )
    command = [sys.executable, "-c", code]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=120, check=False)
    assert (done.returncode, done.stdout) == (0, "2\n"), done.stderr
