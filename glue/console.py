"""Lines for people, printed to standard error so that standard output carries only results."""

from __future__ import annotations

import logging
import sys
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Final

_MOST_LETTERS: Final = 10_000  # in a part of a traceback, such as the text of an exception

_CALLERS: Final = frozenset({"glue", "experiment_runner"})
"""Packages that call users' code."""

LOG: Final = logging.getLogger("glue.client")
"""Log of a hub's clients: whether the hub can be reached, and which sessions a player is in."""


@contextmanager
def errors_only() -> Iterator[None]:
    """Log only errors of clients, within a `with` statement."""
    level = LOG.level
    LOG.setLevel(logging.ERROR)
    try:
        yield
    finally:
        LOG.setLevel(level)


def say(line: str) -> None:
    """Print a line to standard error, at once and in one piece, because several threads may print."""
    print(f"{line}\n", end="", file=sys.stderr, flush=True)


_Report = Callable[[str], object]
_report: Final[ContextVar[_Report | None]] = ContextVar("report", default=None)


_printed_by_others: Final[ContextVar[bool]] = ContextVar("printed_by_others", default=False)


@contextmanager
def reporting(report: _Report) -> Iterator[None]:
    """Also pass lines of `say_why_slow` to `report`, within a `with` statement and in this thread."""
    token = _report.set(report)
    try:
        yield
    finally:
        _report.reset(token)


def leave_printing_to_others() -> None:
    """Do not print reported lines in this thread: the waiting program prints them on the same terminal."""
    _printed_by_others.set(True)


def say_why_slow(line: str) -> None:
    """Print a line that says why an answer will take long, and report it to the waiting program."""
    report = _report.get()
    if report is None or not _printed_by_others.get():
        say(line)
    if report is not None:
        report(line)


def show_failure(error: BaseException) -> None:
    """Print the traceback of an exception from a user's code, without our own frames above that code."""
    trace = error.__traceback__
    while trace is not None and _package(trace.tb_frame.f_globals) in _CALLERS:
        trace = trace.tb_next
    lines = traceback.format_exception(type(error), error, trace or error.__traceback__)
    shown = [line if len(line) <= _MOST_LETTERS else f"{line[:_MOST_LETTERS]}...\n" for line in lines]
    say("".join(shown).removesuffix("\n").encode("utf-8", "backslashreplace").decode())


def _package(variables: dict[str, object]) -> str:
    return str(variables.get("__name__")).partition(".")[0]
