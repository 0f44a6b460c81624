"""`glue-compete serve`, and the acts of its organiser."""

from __future__ import annotations

import os
import secrets
from collections.abc import Callable
from contextlib import ExitStack, nullcontext, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import click

from experiment_runner.cli.options import check_address, naming_out
from experiment_runner.cli.season_page import page_options, place_of_page
from experiment_runner.plan.limits import Backend
from glue.cli.shared import DIRECTORY, FILE
from glue.console import one_line, say
from glue.errors import ConfigError, ExperimentError, GlueError
from glue.files import read_text
from glue.hub.config import DEFAULT_HUB
from glue.system import clock

if TYPE_CHECKING:
    from experiment_runner.view.server import Place

KEPT: Final = "nothing is lost: start the same command again"

_TRIES: Final = 4

RUN = click.argument("directory", type=DIRECTORY, metavar="DIR")


def _reason(context: click.Context, option: click.Parameter, text: str) -> str:
    if not text.strip() or not text.isprintable():
        raise click.BadParameter("a reason is a line of printable text")
    return text.strip()


_WHY: Final = click.option(
    "--why",
    "--reason",
    "why",
    required=True,
    callback=_reason,
    metavar="TEXT",
    help="Reason, in a line for all to read: it is sealed with the run, and shown on the board.",
)


@click.command()
@click.argument("file", type=FILE, metavar="FILE")
@click.option(
    "--out",
    type=DIRECTORY,
    required=True,
    metavar="DIR",
    help="Directory of the season; if it contains this season, the season continues.",
)
@click.option(
    "--bind",
    default=DEFAULT_HUB,
    show_default=True,
    metavar="URL",
    help="Address for entrants with keys, and the first of as many ports as attempts are played at once.",
)
@click.option("--keys", type=DIRECTORY, metavar="DIR", help="Directory with the hub's pair; see glue-keys.")
@click.option("--page", metavar="HOST:PORT", help="Address of the page of the season; none without it.")
@page_options
@click.option(
    "--engine",
    type=click.Choice([Backend.LOCAL.value, Backend.RAY.value]),
    default=Backend.LOCAL.value,
    show_default=True,
    help="Where attempts of images and commands are played: on this machine, or on a Ray cluster.",
)
@click.option("--address", metavar="HOST:PORT", help="Ray cluster; by default the one that Ray finds.")
def serve(
    file: Path, out: Path, bind: str, keys: Path | None, engine: str, address: str | None, **of_page: Any
) -> None:
    """Hold the season of FILE, for weeks: let entrants play attempts, and verify each at its end.

    It ends when `close` closes the season. If anything else stops it, the same command continues it.
    """
    from experiment_runner.competition.organiser import open_competition
    from experiment_runner.competition.records.journal import utc_now
    from experiment_runner.competition.season.images import remove_others
    from experiment_runner.competition.season.server import Server, check_gate
    from experiment_runner.competition.settings import Gate, load_competition
    from experiment_runner.competition.trials import read_code, read_secret
    from experiment_runner.competition.worker import executor_of
    from experiment_runner.executors.opening import kept_if_begun
    from experiment_runner.view.launch import check_view, season_viewed

    check_address(Backend(engine), address)
    has_page = of_page["page"] is not None
    if has_page:
        check_view("page")
        # The page is a process of its own, restarted whenever it ends: here a mistake is reported only once.
        _check_free(place_of_page(of_page["page"], of_page["proxy"], of_page["insecure"]))
    competition = load_competition(file)
    if competition.season is None:
        raise ConfigError(f"{file} has no table [season]: glue-compete run holds its competition")
    secret = read_secret(competition, os.environ, say)
    code = read_code(competition.season, os.environ, say)
    gate = None if keys is None else Gate(bind, keys.absolute())
    check_gate(competition, gate)

    with kept_if_begun(out, lambda: say(KEPT)), ExitStack() as stack:
        with naming_out():
            text = read_text(file, follow=True)
            store = stack.enter_context(open_competition(out, text, competition, secret))
        executor = executor_of(competition, Backend(engine), address)
        page = season_viewed(out, of_page, say) if has_page else nullcontext()
        with page, Server(store, competition, secret, code, gate, say) as server:
            say(f"the season is served from {out}")
            server.serve(executor)
        if has_page and of_page["publish"] is not None:
            from experiment_runner.view.season.publish import Publisher
            from experiment_runner.view.season.views import Views

            Publisher(Views(out, utc_now), of_page["publish"]).publish()  # the final state
        if competition.season.images:
            with suppress(GlueError, ImportError):  # without an engine there are none
                remove_others(out)
        say(f"the season is closed; now: glue-compete run {file} --out {out}")


def _check_free(place: Place) -> None:
    """Check that a page can listen at a place; that of a server which was killed may hold it for a moment.

    Raises:
        ConfigError: it cannot.
    """
    from experiment_runner.view.server import listen

    for left in reversed(range(_TRIES)):
        try:
            listen(place).close()
            break
        except ConfigError:
            if not left:
                raise
            clock.sleep(1.0)


@click.command()
@RUN
@click.argument("file", type=FILE, metavar="FILE")
@_WHY
def add(directory: Path, file: Path, why: str) -> None:
    """Add the entrants of FILE that the run in DIR does not have yet.

    They play at once, or when the run is started again.
    """
    from experiment_runner.competition.course import course_of
    from experiment_runner.competition.season.acts import addition

    organise(directory, "add", why=why, **addition(course_of(directory), file, secrets.token_bytes()))


@click.command()
@RUN
@click.argument("entrants", nargs=-1, required=True, metavar="ENTRANT...")
@_WHY
def exclude(directory: Path, entrants: tuple[str, ...], why: str) -> None:
    """Take entrants of the run in DIR off the board; everything that they played is kept."""
    for name in dict.fromkeys(entrants):
        organise(directory, "exclude", subject=name, why=why)


@click.command()
@RUN
@click.argument("which", nargs=-1, required=True, metavar="TRIAL... | ENTRANT [ATTEMPT]")
@_WHY
def rerun(directory: Path, which: tuple[str, ...], why: str) -> None:
    """Have something played again, on the same levels; it counts instead of the old, which is kept.

    In a season, an attempt of an entrant, by default its last; in a run, trials such as alice/easy/0, or all
    of an entrant that are over.
    """
    if "/" in which[0]:
        for trial in dict.fromkeys(which):
            organise(directory, "rerun", subject=trial, why=why)
        return
    name, *number = which
    if len(number) > 1 or not all(text.isdecimal() and len(text) < 10 for text in number):
        raise click.UsageError("name an entrant and at most one attempt, as in: alice 3")
    organise(directory, "rerun", subject=name, why=why, number=int(number[0]) if number else 0)


@click.command()
@RUN
@click.argument("text", callback=_reason, metavar="TEXT")
def announce(directory: Path, text: str) -> None:
    """Show a line of text on the board of the run in DIR."""
    organise(directory, "announce", why=text)


def _act(kind: str, summary: str, *arguments: Callable[[click.Command], click.Command]) -> click.Command:
    """Return the command of an act, whose arguments are those of `control.Organise`."""

    def carry_out(directory: Path, why: str, **wish: Any) -> None:
        organise(directory, kind, why=why, **wish)

    command = click.command(kind, help=summary)(RUN(_WHY(carry_out)))
    for argument in arguments:
        argument(command)
    return command


_ENTRANT: Final = click.argument("subject", metavar="ENTRANT")
_ANYBODY: Final = click.argument("subject", default="", metavar="[ENTRANT]")
_NUMBER: Final = click.argument("number", type=click.IntRange(1, 10_000), metavar="N")

ACTS: Final = (
    add,
    announce,
    exclude,
    rerun,
    _act("close", "End the season in DIR: what waits is cancelled, what is being played is finished."),
    _act("freeze", "Stop the public board of the season in DIR from changing; the organiser's still does."),
    _act("grant", "Grant an entrant of the season in DIR further attempts, on any day.", _ENTRANT, _NUMBER),
    _act(
        "pause",
        "Start nothing more of an entrant of the season or run in DIR, or of anyone, but end nothing.",
        _ANYBODY,
    ),
    _act("readmit", "Put an entrant that was excluded from the run in DIR back on the board.", _ENTRANT),
    _act("resume", "End a pause of an entrant of the season or run in DIR, or of everyone.", _ANYBODY),
    _act("thaw", "Let the public board of the season in DIR show everything again."),
)


def organise(directory: Path, kind: str, **wish: Any) -> None:
    """Carry out a wish of the organiser, by the server of the run if there is one, and show the acts: without
    one, they are written to the journal here.

    Raises:
        ExperimentError: it is refused, or the directory holds no competition.
    """
    from experiment_runner.competition.board.forms import line_of
    from experiment_runner.competition.course import course_of
    from experiment_runner.competition.records.journal import utc_now
    from experiment_runner.competition.records.seal import check_seal, record_acts, seal
    from experiment_runner.competition.season.acts import acts_for
    from experiment_runner.competition.season.control import NoServer, Organise, ask
    from experiment_runner.store.store import Store

    try:
        reply = ask(directory, {"do": "act", "act": kind, **wish})
    except NoServer:
        with Store.open(directory) as store:
            seal(store)
            check_seal(store)
            acts = acts_for(Organise(kind, **wish), course_of(directory), store.outcomes(), utc_now())
            record_acts(store, acts)
        lines = [line_of(one) for one in acts]
    else:
        if not reply["ok"]:
            raise ExperimentError(one_line(str(reply["error"])))
        lines = reply["acts"]
    for line in lines:
        say(line)
