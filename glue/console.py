"""Lines for people: printed to standard error, so that standard output carries results alone."""

from __future__ import annotations

import sys
import traceback
from typing import Final

__all__ = ["say", "show_failure"]

_CALLERS: Final = frozenset({"glue", "experiment_runner"})
"""Packages that call the code of users."""


def say(line: str) -> None:
    """Print a line to standard error, at once and in one piece: several threads may print."""
    print(f"{line}\n", end="", file=sys.stderr, flush=True)


def show_failure(error: BaseException) -> None:
    """Print the traceback of an exception from a user's code, without our own frames above that code."""
    trace = error.__traceback__
    while trace is not None and _package(trace.tb_frame.f_globals) in _CALLERS:
        trace = trace.tb_next
    traceback.print_exception(type(error), error, trace or error.__traceback__)


def _package(variables: dict[str, object]) -> str:
    return str(variables.get("__name__")).partition(".")[0]
