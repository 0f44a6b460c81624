"""Parts that several commands share: the option `--over`, and the remedy for a directory in use."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final

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
def naming_out(otherwise: str = "") -> Iterator[None]:
    """Name the option --out in the message of a `DirectoryTaken`.

    Args:
        otherwise: another remedy, appended to the message.
    """
    try:
        yield
    except DirectoryTaken as error:
        raise ExperimentError(f"{error}: choose another directory with --out{otherwise}") from None
