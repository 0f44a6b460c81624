"""Subcommands of `glue-results` that show runs, list and show, and that compare settings: compare, table,
power, sensitivity.
"""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path

import click

from experiment_runner.analysis.settings import collect
from experiment_runner.analysis.stats import FEW_TRIALS
from experiment_runner.cli import options
from experiment_runner.report.comparing import COLUMNS, compared, left_out, needed, sensitivities
from experiment_runner.report.markup import LATEX, MARKDOWN, paper_table
from experiment_runner.report.overview import FEW, Overview, as_object, as_text, overview
from experiment_runner.report.tables import format_table, terminal_width
from experiment_runner.store.results import Results, opened
from glue.cli.shared import DIRECTORY
from glue.console import one_line, say
from glue.errors import ConfigError, ExperimentError


@click.command("list")
@click.argument("folder", type=DIRECTORY, default="runs")
@options.json_option
def list_runs(folder: Path, as_json: bool) -> int:
    """List the runs in FOLDER (by default runs) and its subfolders.

    \b
    Examples:
      glue-results list
      glue-results list /data/mario
      glue-results list --json | jq -r '.[] | select(.state == "failed") | .run'
    """
    from experiment_runner.store.layout import runs_under  # show does not need its module

    if not folder.is_dir():
        raise ConfigError(f"there is no folder {folder}")
    overviews: list[Overview] = []
    unreadable: list[str] = []
    for directory in runs_under(folder):
        try:
            with Results.open(directory) as found:
                overviews.append(overview(found))
        except ExperimentError as error:
            unreadable.append(one_line(str(error)))
    if as_json:
        click.echo(json.dumps([one.as_json() for one in overviews], indent=2))
    elif overviews:
        rows = [one.cells() for one in overviews]
        click.echo(format_table(Overview.COLUMNS, rows, width=terminal_width(), prose=True))
    elif not unreadable:
        say(f"there are no runs in {folder}")
    for line in unreadable:
        say(f"Error: {line}")
    return 1 if unreadable else 0


@click.command()
@options.RUNS
@click.option(
    "--sort",
    type=click.Choice(["setting", "mean", "IQM", "converged"]),
    help="Column by which the settings are sorted: the best return or the earliest convergence first. "
    "[default: as in the plan]",
)
@options.over_option
@options.json_option
def show(directories: tuple[Path, ...], sort: str | None, over: str, as_json: bool) -> None:
    """Show the results of each RUN: a line for each setting, then failures and other events.

    Trials of the same setting are pooled across runs. The JSON of one run is an object, of several an
    array of objects.

    \b
    Examples:
      glue-results show runs/mine
      glue-results show runs/mine runs/other --sort mean
      glue-results show runs/mine --json | jq '.settings[].mean'
    """
    with opened(directories) as runs:
        if as_json:
            found = [as_object(run, over) for run in runs]
            click.echo(json.dumps(found[0] if len(found) == 1 else found, indent=2))
        else:
            click.echo(as_text(runs, terminal_width(), sort, over))


@click.command()
@click.argument("first", metavar="A", type=DIRECTORY)
@click.argument("second", metavar="B", type=DIRECTORY)
@options.over_option
@options.json_option
def compare(first: Path, second: Path, over: str, as_json: bool) -> None:
    """Compare the agents of two runs over the trials that both have: A less B, in each environment.

    The interquartile mean and the probability of improvement (that a trial of A has a greater return than
    one of B) have 95 % bootstrap intervals. The performance of a trial is the mean return of its last 100
    episodes or, over steps, of its last tenth.

    \b
    Examples:
      glue-results compare runs/new runs/old
      glue-results compare runs/new runs/old --over steps --json
    """
    with Results.open(first) as a, Results.open(second) as b:
        rows, notes = compared(a, b, over), left_out(a, b)
    if as_json:
        click.echo(json.dumps([row.as_json() for row in rows], indent=2))
    else:
        click.echo(format_table(COLUMNS, [row.cells() for row in rows], width=terminal_width()))
        if any(row.found.trials < FEW_TRIALS for row in rows):
            click.echo(f"({FEW.strip()} fewer than {FEW_TRIALS} trials: their intervals are too narrow)")
    _say_all(notes)


@click.command("table")
@options.RUNS
@click.option(
    "--format",
    "kind",
    type=click.Choice(["latex", "markdown"]),
    default="markdown",
    show_default=True,
    help="For LaTeX, with the package booktabs, or for Markdown.",
)
@options.over_option
@options.select_option
def table_command(directories: tuple[Path, ...], kind: str, over: str, select: tuple[str, ...]) -> None:
    """Write the table of a paper: a row for each agent, a column for each environment of each RUN.

    A cell is the mean over trials, with its 95 % bootstrap interval, of the mean return of the last 100
    episodes or, over steps, of the last tenth; as in glue-results show.

    \b
    Examples:
      glue-results table runs/sweep --format latex > table.tex
      glue-results table runs/mine runs/other --select sarsa
    """
    with opened(directories) as runs:
        settings = options.selected(collect(runs), select)
    click.echo(paper_table(settings, over, LATEX if kind == "latex" else MARKDOWN))


@click.command()
@options.RUN
@click.option("--difference", type=float, required=True, metavar="D", help="Difference of the mean returns.")
@click.option(
    "--power",
    "chance",
    type=click.FloatRange(0, 1, min_open=True, max_open=True),
    default=0.8,
    show_default=True,
    help="Probability with which it is to be seen.",
)
@options.over_option
def power(directory: Path, difference: float, chance: float, over: str) -> None:
    """Show how many trials of two agents are needed to detect a difference D, from a pilot RUN.

    D is detected if the 95 % interval of Welch's t-test excludes 0; comparisons are simulated from the trials
    of each setting.

    \b
    Examples:
      glue-results power runs/pilot --difference 10
    """
    if difference == 0:
        raise ConfigError("--difference is not 0")
    with Results.open(directory) as found:
        rows, notes = needed(found, difference, chance, over), left_out(found)
    click.echo(
        format_table(("setting", "pilot trials", "trials of each agent"), rows, width=terminal_width())
    )
    _say_all(notes)


@click.command()
@options.RUN
@options.over_option
def sensitivity(directory: Path, over: str) -> None:
    """Show how sensitive each agent of a sweep over several environments is to its options.

    The sensitivity is the loss from using one configuration for all environments instead of the best one of
    each, in scores that are normalised in each environment (Adkins et al. 2024).

    \b
    Examples:
      glue-results sensitivity runs/sweep
    """
    with Results.open(directory) as found:
        rows, notes = sensitivities(found, over), left_out(found)
    columns = ("agent", "configurations", "environments", "sensitivity", "best on average")
    click.echo(format_table(columns, rows, width=terminal_width(), prose=True))
    _say_all(notes)


def _say_all(lines: Iterable[str]) -> None:
    for line in lines:
        say(f"note: {line}")
