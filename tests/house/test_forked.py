"""Processes forked by several threads: no exit code is lost."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

from tests.forked import Forked


def ended(code: int) -> int | None:
    return Forked(int, code).wait(60)


def test_threads_that_start_processes_read_each_exit_code() -> None:
    with ThreadPoolExecutor(10) as pool:
        codes = [number % 7 for number in range(150)]
        assert list(pool.map(ended, codes)) == codes
