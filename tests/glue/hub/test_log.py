"""A log never makes its callers wait, and says how many lines were dropped."""

from __future__ import annotations

import threading

from glue.hub.log import Log


def test_lines_are_written_in_order_and_all_before_the_end() -> None:
    written: list[str] = []
    log = Log(written.append)
    for number in range(500):
        log(f"{number}")
    log.close()
    log("too late")
    assert written == [f"{number}" for number in range(500)]


def test_lines_that_do_not_fit_are_counted_and_dropped() -> None:
    written: list[str] = []
    stuck, go_on = threading.Event(), threading.Event()

    def write(line: str) -> None:
        stuck.set()
        go_on.wait()
        written.append(line)

    log = Log(write)
    log("first")
    stuck.wait()
    for number in range(5000):
        log(f"{number}")
    go_on.set()
    log.close()
    *lines, last = written
    assert lines == ["first", *map(str, range(1000))]
    assert last.startswith("4000 more lines were dropped")
