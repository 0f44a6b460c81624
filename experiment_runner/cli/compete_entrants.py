"""The commands of `glue-compete` for entrants of a season; `glue-agent --season` plays an attempt."""

from __future__ import annotations

import shutil
import subprocess
import sys
import tempfile
from contextlib import ExitStack
from pathlib import Path
from typing import Final

import click

from experiment_runner.competition.season.starter import LANGUAGES, write_starter
from glue.cli.season import show
from glue.cli.shared import DIRECTORY, FILE
from glue.console import say
from glue.errors import ConfigError

_SEASON: Final = click.option(
    "--season",
    type=FILE,
    default=Path("season.toml"),
    show_default=True,
    metavar="FILE",
    help="What glue-compete join has written.",
)


@click.command()
@click.argument("address")
@click.option("--name", required=True, help="Your name in the season: letters, digits and _ . + -.")
@click.option("--code", default="", help="The code for enrolling, from the organiser.")
@click.option("--team", default="", help="Your team, if the season has teams.")
@click.option(
    "--dir",
    "directory",
    type=DIRECTORY,
    default=Path(),
    metavar="DIR",
    help="Where to write season.toml and your keys. [default: the working directory]",
)
def join(address: str, name: str, code: str, team: str, directory: Path) -> None:
    """Enrol in the season whose page is at ADDRESS: make your keys, and write season.toml."""
    from experiment_runner.competition.records.record import NAMES, is_name
    from glue.client.libzmq import new_pair
    from glue.client.season import SEASON_FILE, Page
    from glue.client.season import join as enrol
    from glue.keys.certificates import SECRET, write_pair

    file = directory / SEASON_FILE
    if file.exists():
        raise ConfigError(f"{file} exists: you have joined a season here; choose another --dir")
    if not is_name(name):
        raise ConfigError(f"{name!r:.80} cannot be a name: {NAMES}")
    page = Page(address)
    secret = directory / f"{name}{SECRET}"
    if not secret.exists():  # the answer of an earlier try may have been lost
        write_pair(directory, name, new_pair())
    membership, alias = enrol(page, name, secret, code, team)
    membership.write(file)
    say(f"{file}: what glue-agent --season needs. Do not share it or {secret}")
    say(f"your row on the page: {page.url}/?token={membership.token}")
    if alias != name:
        say(f"others see you there as {alias}")
    say(f"now: glue-agent sample --season {file}, or your own agent in place of sample")


@click.command()
@click.argument("image")
@_SEASON
def submit(image: str, season: Path) -> None:
    """Hand in IMAGE, a container image or its tar of docker save, and have it play an attempt.

    The season plays it: Ctrl-C ends only the waiting.
    """
    from glue.client.season import Season, read_membership

    found = Season(read_membership(season))
    with ExitStack() as stack:
        path = Path(image)
        if not path.is_file():
            folder = stack.enter_context(tempfile.TemporaryDirectory(prefix="glue-"))
            path = _saved(image, Path(folder) / "image.tar")
        try:
            file = stack.enter_context(path.open("rb"))
        except OSError as error:
            raise ConfigError(f"cannot read {path}: {error.strerror}") from None
        say(f"sending {path.stat().st_size / 2**20:.1f} MiB")
        found.submit(file)
    say("the season has the image, which plays your attempts from now on")
    show(found.play(None, say))


def _saved(image: str, path: Path) -> Path:
    """Save an image of the engine as a tar."""
    engine = next((program for program in ("docker", "podman") if shutil.which(program)), None)
    if engine is None:
        raise ConfigError(f"there is no file {image}, and no docker here to look for such an image")
    done = subprocess.run([engine, "save", "--output", str(path), image], capture_output=True, text=True)
    if done.returncode:
        raise ConfigError(f"{engine} cannot save the image {image}: {done.stderr.strip()[-300:]}")
    return path


@click.command()
@click.argument("attempt", type=click.IntRange(1))
@_SEASON
def withdraw(attempt: int, season: Path) -> None:
    """Take ATTEMPT, a number, off the board; one that waits is cancelled, and costs nothing."""
    from glue.client.season import Season, read_membership

    Season(read_membership(season)).ask("withdraw", {"attempt": attempt})
    say(f"attempt {attempt} no longer counts")


@click.command("try")
@click.argument("player", metavar="IMAGE|my.py:AGENT")
@_SEASON
def try_command(player: str, season: Path) -> int:
    """Play the tasks of the season here, without being counted, and say what the season would say.

    An image plays in the same jail as there, on other levels; anything else is an agent for glue-agent.
    """
    from experiment_runner.competition.check import try_entrant
    from experiment_runner.competition.season.trying import competition_of
    from experiment_runner.competition.settings import Entrant
    from glue.client.season import Page, read_membership
    from glue.plugins.loading import names
    from glue.wire.messages import Role

    membership = read_membership(season)
    competition = competition_of(Page(membership.page).ask("GET", "tasks"))
    is_agent = player in names(Role.AGENT) or ".py:" in player
    entrant = Entrant(
        membership.name,
        image=None if is_agent else player,
        command=(sys.executable, "-P", "-m", "glue_rl", "agent", player) if is_agent else (),
    )
    logs = Path(tempfile.mkdtemp(prefix="glue-try-"))
    return min(1, try_entrant(competition, entrant, logs, say))


@click.command()
@click.argument("language", type=click.Choice(LANGUAGES))
@click.argument("directory", type=DIRECTORY, metavar="DIR")
def starter(language: str, directory: Path) -> None:
    """Write a small repository to DIR with an agent in LANGUAGE, and a workflow that tries and submits it."""
    write_starter(language, directory)
    say(f"{directory / 'README.md'} says what to do next")


COMMANDS: Final = (join, starter, submit, try_command, withdraw)
"""The commands of this module."""
