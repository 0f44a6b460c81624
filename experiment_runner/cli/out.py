"""Parts that several commands share: the option `--over`, and the remedy for a directory in use."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, redirect_stdout, suppress
from typing import Final, TextIO

import click

from experiment_runner.store.lock import DirectoryTaken
from glue.errors import ExperimentError

over_option: Final = click.option(
    "--over",
    type=click.Choice(["episodes", "steps"]),
    default="episodes",
    show_default=True,
    help="Count in episodes, or in steps: each step has the return of the episode under way.",
)
"""Decorator of a command that counts in episodes or in steps."""


@contextmanager
def results_alone() -> Iterator[TextIO]:
    """Yield standard output for results alone: whatever else is printed there goes to standard error.

    That is also what players print, in this process, in compiled code or in processes of their own.
    """
    results = sys.stdout
    with ExitStack() as stack:
        with suppress(OSError):  # a test's buffer, which has no descriptor
            number = results.fileno()
            results.flush()
            ours = os.dup(number)
            results = stack.enter_context(open(ours, "w", encoding="utf-8"))
            os.dup2(sys.stderr.fileno(), number)
            stack.callback(os.dup2, ours, number)
        stack.enter_context(redirect_stdout(sys.stderr))
        yield results


@contextmanager
def naming_out(otherwise: str = "") -> Iterator[None]:
    """Name the option --out in the message of a `DirectoryTaken`.

    Args:
        otherwise: another remedy, appended to the message.
    """
    try:
        yield
    except DirectoryTaken as error:
        raise ExperimentError(f"{error}: choose another directory with --out{otherwise}") from None
