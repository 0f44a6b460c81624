"""Subcommands of `glue-results` that show runs: list, show."""

from __future__ import annotations

import json
from contextlib import ExitStack
from pathlib import Path

import click

from experiment_runner.cli.options import DIRECTORY, RUNS, json_option, over_option
from experiment_runner.report.overview import Overview, as_object, as_text, overview
from experiment_runner.report.tables import format_table, terminal_width
from experiment_runner.store.results import Results
from glue.console import one_line, say
from glue.errors import ConfigError, ExperimentError


@click.command("list")
@click.argument("folder", type=DIRECTORY, default="runs")
@json_option
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
@RUNS
@click.option(
    "--sort",
    type=click.Choice(["setting", "mean", "IQM", "converged"]),
    help="Column by which the settings are sorted: the best return or the earliest convergence first. "
    "[default: as in the plan]",
)
@over_option
@json_option
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
    with ExitStack() as stack:
        runs = [stack.enter_context(Results.open(directory)) for directory in directories]
        if as_json:
            found = [as_object(run, over) for run in runs]
            click.echo(json.dumps(found[0] if len(found) == 1 else found, indent=2))
        else:
            click.echo(as_text(runs, terminal_width(), sort, over))
