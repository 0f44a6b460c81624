"""`glue-results`: list, show, export, merge and remove runs, and save a trained agent of one."""

from __future__ import annotations

import json
import sys
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING

import click

from glue import __version__
from glue.commands import run
from glue.console import say
from glue.errors import ConfigError, ExperimentError
from glue.suggestions import did_you_mean

if TYPE_CHECKING:
    from experiment_runner.report.overview import Overview
    from experiment_runner.store.records import TrialRecord
    from experiment_runner.store.results import Results

__all__ = ["main", "results"]

_directory = click.Path(path_type=Path, file_okay=False)
_as_json = click.option("--json", "as_json", is_flag=True, help="Print JSON.")


@click.group("glue-results")
@click.version_option(__version__, prog_name="glue-results")
def results() -> None:
    """Work with the results of experiments, also while they run.

    A run is a directory that glue-experiment created (its --out).

    \b
    Examples:
      glue-results list
      glue-results show runs/mine
      glue-results export runs/mine --out mine.csv
      glue-results merge runs/lab1 runs/lab2 --out runs/both
      glue-results agent runs/mine --out mine.agent
      glue-results remove runs/mistake
    """


@results.command("list")
@click.argument("folder", type=_directory, default="runs")
@_as_json
def list_runs(folder: Path, as_json: bool) -> int:
    """List the runs in FOLDER (by default runs) and its subfolders.

    \b
    Examples:
      glue-results list
      glue-results list /data/mario
      glue-results list --json | jq -r '.[] | select(.state == "failed") | .run'
    """
    from experiment_runner.report.overview import Overview, overview
    from experiment_runner.report.tables import format_table, one_line, terminal_width
    from experiment_runner.store.layout import runs_under
    from experiment_runner.store.results import Results

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


@results.command()
@click.argument("directory", metavar="RUN", type=_directory)
@_as_json
def show(directory: Path, as_json: bool) -> None:
    """Show the results of a RUN: a line for each setting, then failures and other events.

    \b
    Examples:
      glue-results show runs/mine
      glue-results show runs/mine --json | jq '.settings[].mean'
    """
    from experiment_runner.report.overview import as_object, as_text
    from experiment_runner.report.tables import terminal_width
    from experiment_runner.store.results import Results

    with Results.open(directory) as found:
        if as_json:
            click.echo(json.dumps(as_object(found), indent=2))
        else:
            click.echo(as_text(found, terminal_width()))


@results.command()
@click.argument("directory", metavar="RUN", type=_directory)
@click.option(
    "--format", "kind", type=click.Choice(["csv", "json", "parquet"]), default="csv", show_default=True
)
@click.option(
    "--out", type=click.Path(path_type=Path, dir_okay=False), help="File. [default: standard output]"
)
def export(directory: Path, kind: str, out: Path | None) -> None:
    """Export the episodes of a RUN as one table: trial, episode, return, steps, terminal, ...

    Each episode is a row, each option of agent and environment a column. Parquet needs --out.

    \b
    Examples:
      glue-results export runs/mine --format csv --out mine.csv
      glue-results export runs/mine --format json | jq '.[-1]'
    """
    from experiment_runner.store.database import reported
    from experiment_runner.store.export import write_csv, write_json, write_parquet
    from experiment_runner.store.output import written
    from experiment_runner.store.results import Results

    with Results.open(directory) as found:
        if kind == "parquet":
            if out is None:
                raise ConfigError(
                    "Parquet is binary and cannot go to standard output: name a file with --out FILE"
                )
            write_parquet(found, out)
            say(f"wrote {out}")
            return
        write = write_csv if kind == "csv" else write_json
        if out is None:
            with reported("cannot write the table"):
                write(found, sys.stdout)
                sys.stdout.flush()
            return
        with written(out) as partial, partial.open("w", encoding="utf-8", newline="") as file:
            write(found, file)
    say(f"wrote {out}")


@results.command()
@click.argument("directories", metavar="RUN...", nargs=-1, required=True, type=_directory)
@click.option("--out", required=True, type=_directory, help="Directory of the new run.")
def merge(directories: tuple[Path, ...], out: Path) -> None:
    """Merge runs into a new one; the originals stay unchanged.

    Runs of the same plan, from different machines, become a run of that plan, which glue-experiment
    --resume completes if episodes are missing. Runs of different plans become one for viewing only.

    \b
    Examples:
      glue-results merge runs/lab1 runs/lab2 --out runs/both
    """
    from experiment_runner.store.merge import merge as merge_runs
    from experiment_runner.store.results import Results

    with ExitStack() as stack:
        merge_runs([stack.enter_context(Results.open(directory)) for directory in directories], out)
    say(f"wrote {out}")


@results.command()
@click.argument("directory", metavar="RUN", type=_directory)
@click.option("--trial", "trial_id", metavar="ID", help="The trial; not needed if the run has one only.")
@click.option(
    "--out",
    "-o",
    required=True,
    type=click.Path(path_type=Path, dir_okay=False),
    metavar="FILE",
    help="File to write; an existing file is replaced.",
)
def agent(directory: Path, trial_id: str | None, out: Path) -> None:
    """Write the agent of a RUN, as of the newest checkpoint of its trial, to a file.

    glue-agent NAME --load FILE and glue-watch --load FILE load it into an agent of the same name and options.

    \b
    Examples:
      glue-results agent runs/mine --out mine.agent
      glue-results agent runs/sweep --trial sarsa/step_size=0.1/mines/0 --out mines.agent
    """
    from experiment_runner.report.tables import counted
    from experiment_runner.store.output import written
    from experiment_runner.store.results import Results

    with Results.open(directory) as found:
        trial = _trial(found, trial_id)
        checkpoint = found.checkpoint(trial.spec.id)
        if checkpoint is None:
            raise ExperimentError(_why_unsaved(found, trial))
    episode, saved = checkpoint
    with written(out) as partial:
        partial.write_bytes(saved.agent)
    say(f"wrote {out}: the agent of {trial.spec.id} after {counted(episode, 'episode')}")


@results.command()
@click.argument("directories", metavar="RUN...", nargs=-1, required=True, type=_directory)
@click.option("--yes", "-y", is_flag=True, help="Do not ask for confirmation.")
def remove(directories: tuple[Path, ...], yes: bool) -> None:
    """Remove each RUN, after confirmation.

    Only the files of the run are removed; other files in its directory, such as recordings, are kept.

    \b
    Examples:
      glue-results remove runs/mistake
      glue-results remove runs/20260101-120000-jumper-mines --yes
    """
    from experiment_runner.report.tables import counted
    from experiment_runner.store.database import reported
    from experiment_runner.store.layout import remove_run
    from experiment_runner.store.results import Results

    for directory in directories:
        if not yes:
            with Results.open(directory) as found:
                trials = found.trials()
            amount = f"{counted(len(trials), 'trial')}, {counted(sum(t.done for t in trials), 'episode')}"
            if not click.confirm(f"remove {directory} ({amount})?", err=True):
                say(f"kept {directory}")
                continue
        with reported(f"cannot remove {directory}"):
            left = remove_run(directory)
        say(
            f"removed {directory}"
            + (f", except files that are not part of the run: {', '.join(left)}" if left else "")
        )


def _trial(found: Results, trial_id: str | None) -> TrialRecord:
    from experiment_runner.store.joined import trial_names

    trials = {trial.spec.id: trial for trial in found.trials()}
    if trial_id is None:
        if not trials:
            raise ExperimentError(f"{found.directory} has no trials")
        if len(trials) > 1:
            raise ConfigError(
                f"{found.directory} has {len(trials)} trials: name one, as in --trial {next(iter(trials))}"
            )
        return next(iter(trials.values()))
    named = {name: trials[identifier] for identifier, name in trial_names(found).items()} | trials
    if trial_id not in named:
        raise ConfigError(f"{found.directory} has no trial {trial_id}{did_you_mean(trial_id, named)}")
    return named[trial_id]


def _why_unsaved(found: Results, trial: TrialRecord) -> str:
    reasons = [e.text for e in found.events() if e.kind == "unsaved" and e.trial_id == trial.spec.id]
    if reasons:
        return f"{trial.spec.id} has no checkpoint: {reasons[-1]}"
    if trial.finished:  # players that can be saved are saved at the end
        return f"{trial.spec.id} has no checkpoint: its agent or environment cannot save itself"
    return (
        f"{trial.spec.id} has no checkpoint yet, after {trial.done} of {trial.spec.episodes} episodes: "
        "one is written at its end, and before that as often as --checkpoint-every says"
    )


def main() -> None:
    """Run `glue-results`."""
    run(results)


if __name__ == "__main__":
    main()
