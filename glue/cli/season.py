"""`glue-agent --season season.toml`: play a whole attempt, every trial with a new agent."""

from __future__ import annotations

import os
import shutil
import subprocess
import tempfile
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import click

from glue.cli.shared import FILE
from glue.console import say
from glue.errors import ConfigError, GlueError, HubUnreachable
from glue.hub.config import HUB_KEY_VARIABLE, HUB_VARIABLE, KEY_VARIABLE, SESSION_VARIABLE

if TYPE_CHECKING:
    from glue.client.season import Progress, Season
    from glue.client.target import Target

_JOIN_SECONDS: Final = 10.0
"""Time for a hub to be there; then the page is asked again."""

_LOOK_SECONDS: Final = 5.0
"""Time after which the page is asked whether a trial is still being played."""

_END_SECONDS: Final = 5.0
"""Time for a program to end after its trial."""

SEASON_SETTINGS: Final[dict[str, Any]] = {
    "type": FILE,
    "metavar": "FILE",
    "help": "Play an attempt of the season of FILE, a season.toml of glue-compete join.",
}
"""The option `--season`."""


def play_agents(file: Path, make: Callable[[], Any], name: str) -> None:
    """Play an attempt, each trial with an agent of `make`, named `name`; print the result.

    Raises:
        GlueError: as `make` and `Season.play`.
    """
    from glue.client.players import serve_agent
    from glue.keys.certificates import encode

    season = _season(file)
    ready = [make()]  # before an attempt is granted: an agent that cannot be made costs none

    def serve(target: Target, on: Callable[[], bool]) -> None:
        key = target.key
        assert key is not None
        try:
            serve_agent(
                {target.session: ready.pop() if ready else make()},
                target.hub,
                key=key.file,
                hub_key=encode(key.hub),
                wait=_JOIN_SECONDS,
                name=name,
            )
        except HubUnreachable:
            pass  # the trial may be over
        except GlueError as error:
            say(f"Error: {error}")  # the trial is forfeited, but not the next one

    show(season.play(serve, say))


def play_programs(file: Path, command: Sequence[str]) -> None:
    """Play an attempt, each trial with a new process of a program; without one, print where to find the hub.

    A program finds the hub without a key, through a relay of this process, so that it can be in any language.

    Raises:
        ConfigError: there is no such program.
        GlueError: as `Season.play`.
    """
    from glue.client.libzmq import Relay
    from glue.system import clock

    if command and shutil.which(command[0]) is None:
        raise ConfigError(
            f"there is no program {command[0]!r} here: name it with its path, as in ./agent; or an agent in "
            "Python before --season, as in glue-agent my.py:Agent --season season.toml"
        )

    def serve(target: Target, on: Callable[[], bool]) -> None:
        with tempfile.TemporaryDirectory(prefix="glue-") as folder, Relay(f"ipc://{folder}/hub", target):
            place = {HUB_VARIABLE: f"ipc://{folder}/hub", SESSION_VARIABLE: target.session}
            if command:
                _run(command, place, on)
                return
            for name, value in place.items():
                click.echo(f"export {name}={value}")
            while on():
                clock.sleep(_LOOK_SECONDS)

    show(_season(file).play(serve, say))


def _season(file: Path) -> Season:
    from glue.client.season import Season, read_membership

    return Season(read_membership(file))


def show(result: Progress) -> None:
    """Print the result of an attempt, and exit with status 1 if it was forfeited."""
    click.echo(result)
    if result.outcome == "forfeited":
        raise click.exceptions.Exit(1)


def _run(command: Sequence[str], place: dict[str, str], on: Callable[[], bool]) -> None:
    """Run a program until it ends, or its trial is over."""
    others = {name: text for name, text in os.environ.items() if name not in (KEY_VARIABLE, HUB_KEY_VARIABLE)}
    try:
        program = subprocess.Popen(command, env={**others, **place})
    except OSError as error:
        raise ConfigError(f"cannot start {command[0]}: {error.strerror}") from None
    try:
        while on():
            with suppress(subprocess.TimeoutExpired):
                if program.wait(_LOOK_SECONDS):
                    say(f"{command[0]} ended with status {program.returncode}")
                break
    finally:
        for insist in (program.terminate, program.kill):
            insist()  # nothing happens if it has ended
            with suppress(subprocess.TimeoutExpired):
                program.wait(_END_SECONDS)
