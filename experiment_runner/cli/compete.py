"""`glue-compete`: hold a competition."""

from __future__ import annotations

import os
import shlex
import warnings
from collections.abc import Iterable
from contextlib import ExitStack
from pathlib import Path

import click

from experiment_runner.cli.compete_entrants import COMMANDS
from experiment_runner.cli.compete_serve import ACTS, KEPT, RUN, serve
from experiment_runner.cli.options import naming_out
from experiment_runner.cli.season_page import page
from experiment_runner.view.launch import check_view, viewed
from glue import __version__
from glue.cli.shared import DIRECTORY, FILE
from glue.console import say
from glue.errors import ConfigError
from glue.files import read_text
from glue.hub.config import DEFAULT_HUB
from glue.keys.certificates import encode, read_pair, read_public

_FILE = click.argument("file", type=FILE, metavar="FILE")


@click.group("glue-compete", no_args_is_help=True)
@click.version_option(__version__, prog_name="glue-compete")
def compete() -> None:
    """Hold a competition of the entrants and tasks in FILE, in TOML; see docs/competition.md.

    \b
    Examples:
      glue-compete check docker/example/competition.toml
      glue-compete run docker/example/competition.toml --out runs/spring
      glue-compete verify runs/spring --sign organiser.key_secret
      glue-compete board runs/spring --format html > spring.html
    """
    warnings.simplefilter("ignore", RuntimeWarning)  # NumPy's: returns may be infinite or NaN


for _command in (page, serve, *ACTS, *COMMANDS):
    compete.add_command(_command)


@compete.command()
@_FILE
@click.option(
    "--out",
    type=DIRECTORY,
    default=Path("check"),
    show_default=True,
    metavar="DIR",
    help="Directory of the reports, a folder for each entrant.",
)
def check(file: Path, out: Path) -> int:
    """Let every entrant play 3 episodes of each task on a public level, and report to its owner."""
    from experiment_runner.competition.check import check_entrants
    from experiment_runner.competition.settings import load_competition
    from experiment_runner.competition.trials import read_secret

    competition = load_competition(file)
    try:
        read_secret(competition, os.environ, say)  # not needed, but no program may inherit it
    except ConfigError as error:
        say(f"to be done before glue-compete run: {error}")
    with naming_out():
        failed = check_entrants(competition, out, say)
    return 1 if failed else 0


@compete.command("run")
@_FILE
@click.option(
    "--out",
    type=DIRECTORY,
    required=True,
    metavar="DIR",
    help="Directory of the run; if it contains a run of this competition, that run continues.",
)
@click.option(
    "--workers",
    type=click.IntRange(1),
    metavar="N",
    help="Maximum number of concurrent trials. [default: one for every two processors]",
)
@click.option(
    "--keys",
    type=DIRECTORY,
    metavar="DIR",
    help="Directory with the hub's pair of keys, for entrants who join with theirs at --bind; see glue-keys.",
)
@click.option(
    "--bind", default=DEFAULT_HUB, show_default=True, metavar="URL", help="Address for entrants with keys."
)
@click.option("--view", is_flag=True, help="Show the standings on a page in the browser, until Ctrl-C.")
def run_command(file: Path, out: Path, workers: int | None, keys: Path | None, bind: str, view: bool) -> int:
    """Let every entrant play every task. After an interruption, the same command plays the rest."""
    from experiment_runner.competition.course import course_of
    from experiment_runner.competition.organiser import hold, open_competition
    from experiment_runner.competition.records.verify import not_installed
    from experiment_runner.competition.season.acts import answering
    from experiment_runner.competition.season.control import Door
    from experiment_runner.competition.settings import Gate, load_competition
    from experiment_runner.competition.trials import read_secret
    from experiment_runner.executors.opening import kept_if_begun

    if view:
        check_view()
    competition = load_competition(file)
    secret = read_secret(competition, os.environ, say)
    text = read_text(file, follow=True)

    with kept_if_begun(out, lambda: say(KEPT)), ExitStack() as stack:
        with naming_out():
            store = stack.enter_context(open_competition(out, text, competition, secret))
        wait = stack.enter_context(viewed(out, say)) if view else None
        gate = None if keys is None else Gate(bind, keys)
        workers = workers or max(1, (os.cpu_count() or 1) // 2)
        with Door(out) as door:
            failed = hold(store, competition, secret, workers, say, gate, answering(door))
        trusted = _allowing(not_installed(store))
        store.close()  # so that it can be verified while the page is open
        total = len(course_of(out).trials)
        if failed:
            say(f"{failed} of {total} trials have failed: start the same command again when that is solved")
        else:
            say(f"all {total} trials are over; now: glue-compete verify {out}{trusted}")
        if wait is not None:
            wait()
    return 1 if failed else 0


def _allowing(names: Iterable[str]) -> str:
    """Return the options of `verify` that allow environments which are not installed."""
    return "".join(f" --env {shlex.quote(name)}" for name in names)


@compete.command()
@RUN
@click.option(
    "--sign",
    type=FILE,
    metavar="FILE",
    help="Secret key with which to sign the results, if all are verified; see glue-keys.",
)
@click.option(
    "--env",
    "environments",
    multiple=True,
    metavar="NAME",
    help="Environment, or opponent in one, that is not installed, and whose code you trust: FILE.py:CLASS, "
    "your copy of the organiser's file, or any other name; repeat it for several.",
)
def verify(directory: Path, sign: Path | None, environments: tuple[str, ...]) -> int:
    """Play every recorded action again, and compare every reward and score, bit for bit."""
    from experiment_runner.competition.course import course_of
    from experiment_runner.competition.records import seal
    from experiment_runner.competition.records.verify import verify as verify_run
    from experiment_runner.competition.season.bundle import board_differs
    from experiment_runner.store.layout import BOARD_FILE
    from experiment_runner.store.store import Store

    pair = None if sign is None else read_pair(sign, "sign")
    course = course_of(directory)
    steps = {task.name: task.steps for task in course.competition.tasks}
    with Store.open(directory) as store:
        if not seal.seal(store):
            say("there was no seal, which version 0.1.0 did not make: the run is sealed as it is now")
        changed = seal.broken(store)
        if changed:
            say(f"{changed} were changed since they were written")
        course.check_trials(record.spec for record in store.trials())
        over = set(store.outcomes())
        problems = verify_run(store, steps, say, environments)
        left = set(course.trials) - over
        differs = board_differs(store)
        if differs:
            say(f"{BOARD_FILE} is not the board of the journal and the records")
        still_broken = seal.broken(store)
    of = f"of {len(over) + len(left)} trials are"
    say(f"{len(over) - problems} {of} verified")
    if left:
        say(f"{len(left)} {of} not over: continue with glue-compete run FILE --out {directory}")
    failed = problems or changed or still_broken or left or differs
    if pair is not None and failed:
        say("nothing was signed")
    elif pair is not None:
        seal.sign(directory, pair)
        say(f"signed with {encode(pair.public)}")
    return 1 if failed else 0


@compete.command()
@RUN
@click.option(
    "--format",
    "form",
    type=click.Choice(["text", "csv", "html", "json"]),
    default="text",
    show_default=True,
    help="For the terminal, as CSV, as one self-contained HTML page, or as JSON.",
)
@click.option("--season", is_flag=True, help="After a season: show its board, not that of the testing tasks.")
@click.option(
    "--reveal", is_flag=True, help="After the competition: show what the secret seed has determined."
)
@click.option(
    "--signed-by",
    metavar="KEY",
    help="Public key of the organiser, or its file: refuse a directory that is not signed with it.",
)
def board(directory: Path, form: str, season: bool, reveal: bool, signed_by: str | None) -> None:
    """Print the standings, which count only verified trials; of a season that is not closed, its board, with
    everything that its organiser may know.
    """
    from experiment_runner.competition.board.forms import as_csv, as_json, as_text
    from experiment_runner.competition.board.standings import standings
    from experiment_runner.competition.course import course_of
    from experiment_runner.competition.records.journal import utc_now
    from experiment_runner.competition.records.seal import check_seal, check_signature
    from experiment_runner.competition.season.board import ORGANISER, season_board
    from experiment_runner.competition.season.forms import as_text as season_text
    from experiment_runner.competition.season.forms import places_of, scores_of
    from experiment_runner.report.tables import terminal_width
    from experiment_runner.store.results import Results
    from experiment_runner.view.export import as_page

    if signed_by is not None:
        check_signature(directory, read_public(signed_by, "signed_by"))
    course, width = course_of(directory), terminal_width()
    with Results.open(directory) as results:
        if season or course.in_season or not course.competition.testing:
            if form == "html":
                raise ConfigError(f"a season has a page: glue-compete page {directory} --publish FOLDER")
            check_seal(results)
            shown = season_board(results, course, utc_now(), ORGANISER)
            forms = {
                "text": lambda: season_text(shown, width),
                "csv": lambda: places_of(shown.competition, scores_of(shown)),
            }
            text = forms.get(form, lambda: as_json(shown))()
        else:
            found = standings(results, course, reveal)
            forms = {"text": lambda: as_text(found, width), "csv": lambda: as_csv(found)}
            text = forms.get(form, lambda: (as_page if form == "html" else as_json)(found))()
    click.echo(text, nl=form == "text")


@compete.command()
@RUN
@click.argument("out", type=DIRECTORY, metavar="OUT")
def bundle(directory: Path, out: Path) -> None:
    """Write into OUT everything of the run in DIR with which others can verify it, when its season is closed.

    These are the file, journal, seal, database, records, levels in files and boards: neither keys nor logs.
    """
    from experiment_runner.competition.records.copies import without_place
    from experiment_runner.competition.season.bundle import bundle as write_bundle

    needed = write_bundle(directory, out)
    trusted = _allowing(map(without_place, needed))
    say(f"anyone who has {out} can verify it: glue-compete verify {out}{trusted}")
    for name in needed:
        say(f"it does not hold the code of {name}: publish that, too")


@compete.command()
@RUN
@click.option(
    "--grades",
    type=click.Choice(["canvas", "moodle", "csv"]),
    required=True,
    help="System that takes the file; csv is for people and spreadsheets.",
)
def export(directory: Path, grades: str) -> None:
    """Print the scores of the run in DIR as grades: of the season, or of the testing tasks once it is closed.

    Entrants are named as they enrolled, so let students enrol with their login.
    """
    from experiment_runner.competition.course import course_of
    from experiment_runner.competition.season.forms import GRADES, grades_of
    from experiment_runner.store.results import Results

    course = course_of(directory)
    with Results.open(directory) as results:
        found = grades_of(results, course)
    click.echo(GRADES[grades](course.competition.name, found), nl=False)
