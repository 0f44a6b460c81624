"""Parts that several commands share: the option `--over`, and the remedy for a directory in use."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager, redirect_stdout, suppress
from typing import TYPE_CHECKING, Final, TextIO

import click

from glue.errors import ConfigError, ExperimentError

if TYPE_CHECKING:
    from experiment_runner.analysis.settings import Setting

over_option: Final = click.option(
    "--over",
    type=click.Choice(["episodes", "steps"]),
    default="episodes",
    show_default=True,
    help="Count in episodes, or in steps: each step has the return of the episode under way.",
)
"""Decorator of a command that counts in episodes or in steps."""


select_option: Final = click.option(
    "--select",
    multiple=True,
    metavar="TEXT",
    help="Only settings with TEXT in their names, which glue-results show prints; repeat it for several.",
)
"""Decorator of a command that shows settings; see `selected`."""


def selected(settings: Sequence[Setting], texts: Sequence[str]) -> list[Setting]:
    """Return the settings with one of some texts in their names; all, if there is no text.

    Raises:
        ConfigError: no setting has it.
    """
    found = [setting for setting in settings if not texts or any(text in setting.label for text in texts)]
    if not found and settings:
        raise ConfigError(f"no setting has {' or '.join(texts)} in its name: there is {settings[0].label}")
    return found


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
    from experiment_runner.store.lock import DirectoryTaken

    try:
        yield
    except DirectoryTaken as error:
        raise ExperimentError(f"{error}: choose another directory with --out{otherwise}") from None
