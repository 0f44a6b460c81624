"""Texts for people: lines on standard error, as standard output carries only results; and texts of others.

Names, reasons and answers come from peers, files and folders of others. Wherever one leaves, for a terminal,
a page or a spreadsheet, it passes through one of these functions: `one_line` for a text of others inside a
line of ours, `for_terminal` for whole lines, `printable` for a page, `cell` for a spreadsheet. JSON is in
ASCII.
"""

from __future__ import annotations

import logging
import sys
import traceback
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from difflib import SequenceMatcher
from typing import Final

_MOST_LETTERS: Final = 10_000  # in a part of a traceback, such as the text of an exception

_CALLERS: Final = frozenset({"glue", "experiment_runner"})
"""Packages that call users' code."""

_MOST: Final = 1000
_MAX_NEAR: Final = 3
_NEAR: Final = 0.6
_MAX_LISTED: Final = 30

LOG: Final = logging.getLogger("glue.client")
"""Log of a hub's clients: whether the hub can be reached, and which sessions a player is in."""


def printable(text: str) -> str:
    """Return a text with `?` for each character that a terminal or page would act upon, or cannot show.

    Such are escape sequences, characters that reverse the direction of writing, and the bytes of a file name
    that are no text. Lines stay lines, and a tab becomes a space.
    """
    if text.isprintable():
        return text
    plain = text.replace("\t", " ").replace("\r\n", "\n")
    return "".join(one if one.isprintable() or one == "\n" else "?" for one in plain)


def one_line(text: str, most: int = _MOST) -> str:
    """Return a text as one printable line; if it has more than `most` characters, without its middle."""
    return _shortened(printable(" ".join(text.split())), most)


def for_terminal(text: str) -> str:
    """Return printable lines, none of them too long.

    All but the first are indented, so that no text of others begins a line that looks like one of ours.
    """
    return "\n  ".join(_shortened(line, _MOST) for line in printable(text).split("\n"))


def cell(text: str) -> str:
    """Return a text for a cell of a spreadsheet, which takes it for text and not for a formula."""
    line = printable(" ".join(text.split()))
    return f"'{line}" if line.startswith(("=", "+", "-", "@")) else line


def _shortened(line: str, most: int) -> str:
    end = most // 4
    return line if len(line) <= most else f"{line[: most - end - 5]} ... {line[-end:]}"


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
    print(f"{for_terminal(line)}\n", end="", file=sys.stderr, flush=True)


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


def did_you_mean(word: str, known: Iterable[str]) -> str:
    """Return the end of a message about an unknown word, such as `; did you mean sarsa?`.

    Without a near miss, list the known words, such as `; choose from mines, skeleton`; the
    result is empty if there are none.
    """
    known = list(known)
    likeness = {other: _likeness(word, other) for other in known}
    near = sorted((other for other in known if likeness[other] >= _NEAR), key=lambda other: -likeness[other])
    if near := near[:_MAX_NEAR]:
        return f"; did you mean {' or '.join(near)}?"
    if not known:
        return ""
    listed = known if len(known) <= _MAX_LISTED else [*known[:_MAX_LISTED], "..."]
    return f"; choose from {', '.join(listed)}"


def _likeness(word: str, other: str) -> float:
    """Return the likeness, 0 to 1. Swapped letters, as in srasa, are sometimes found only from the end."""
    there, back = SequenceMatcher(None, word, other), SequenceMatcher(None, word[::-1], other[::-1])
    return max(there.ratio(), back.ratio())
