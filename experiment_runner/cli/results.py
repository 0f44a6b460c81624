"""`glue-results`: list, show, compare, tabulate, export, merge and remove runs, and save a trained agent."""

from __future__ import annotations

import json
import sys
import warnings
from collections.abc import Iterable
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING

import click

from experiment_runner.cli.out import naming_out, over_option, select_option, selected
from experiment_runner.loggers import LOGGERS
from glue import __version__
from glue.console import one_line, say
from glue.errors import ConfigError, ExperimentError
from glue.suggestions import did_you_mean

if TYPE_CHECKING:
    from collections.abc import Iterator

    from experiment_runner.plan.plan import TrialSpec
    from experiment_runner.report.overview import Overview
    from experiment_runner.store.export import Cell, Table
    from experiment_runner.store.records import TrialRecord
    from experiment_runner.store.results import Results

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
      glue-results table runs/mine --format latex
      glue-results merge runs/lab1 runs/lab2 --out runs/both
      glue-results agent runs/mine --out mine.agent
      glue-results remove runs/mistake
    """
    warnings.simplefilter("ignore", RuntimeWarning)  # NumPy's: returns may be infinite or NaN


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
    from experiment_runner.report.tables import format_table, terminal_width
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
@click.argument("directories", metavar="RUN...", nargs=-1, required=True, type=_directory)
@click.option(
    "--sort",
    type=click.Choice(["setting", "mean", "IQM", "converged"]),
    help="Column by which the settings are sorted: the best return or the earliest convergence first. "
    "[default: as in the plan]",
)
@over_option
@_as_json
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
    from experiment_runner.report.overview import as_object, as_text
    from experiment_runner.report.tables import terminal_width
    from experiment_runner.store.results import Results

    with ExitStack() as stack:
        runs = [stack.enter_context(Results.open(directory)) for directory in directories]
        if as_json:
            found = [as_object(run, over) for run in runs]
            click.echo(json.dumps(found[0] if len(found) == 1 else found, indent=2))
        else:
            click.echo(as_text(runs, terminal_width(), sort, over))


@results.command()
@click.argument("directory", metavar="RUN", type=_directory)
@click.option(
    "--format", "kind", type=click.Choice(["csv", "json", "parquet"]), default="csv", show_default=True
)
@click.option(
    "--out", type=click.Path(path_type=Path, dir_okay=False), help="File. [default: standard output]"
)
@over_option
@click.option(
    "--every",
    type=click.IntRange(1),
    metavar="N",
    help="With --over steps, the steps from one row to the next. [default: a hundredth of the longest trial]",
)
@click.option("--metrics", is_flag=True, help="Export the agents' metrics: a row for each value.")
def export(directory: Path, kind: str, out: Path | None, over: str, every: int | None, metrics: bool) -> None:
    """Export the episodes of a RUN as one table: trial, episode, return, steps, terminal, ...

    Each episode is a row, each option of agent and environment a column. Over steps, each N steps are a row,
    with the mean return of the episodes under way. Parquet needs --out.

    \b
    Examples:
      glue-results export runs/mine --format csv --out mine.csv
      glue-results export runs/mine --format json | jq '.[-1]'
      glue-results export runs/mine --over steps --every 1000
    """
    from experiment_runner.store.database import reported
    from experiment_runner.store.export import (
        episode_table,
        metric_table,
        write_csv,
        write_json,
        write_parquet,
    )
    from experiment_runner.store.output import written
    from experiment_runner.store.results import Results

    if metrics and over == "steps":
        raise ConfigError("metrics have a row for each value: leave out --over steps")
    if every is not None and over != "steps":
        raise ConfigError("--every counts steps: add --over steps")
    with Results.open(directory) as found:
        if metrics:
            table = metric_table(found)
        else:
            table = episode_table(found) if over == "episodes" else _step_table(found, every)
        if kind == "parquet":
            if out is None:
                raise ConfigError(
                    "Parquet is binary and cannot go to standard output: name a file with --out FILE"
                )
            write_parquet(table, out)
            say(f"wrote {out}")
            return
        write = write_csv if kind == "csv" else write_json
        if out is None:
            with reported("cannot write the table"):
                write(table, sys.stdout)
                sys.stdout.flush()
            return
        with written(out) as partial, partial.open("w", encoding="utf-8", newline="") as file:
            write(table, file)
    say(f"wrote {out}")


@results.command()
@click.argument("first", metavar="A", type=_directory)
@click.argument("second", metavar="B", type=_directory)
@over_option
@_as_json
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
    from experiment_runner.analysis.stats import FEW_TRIALS
    from experiment_runner.report.comparing import COLUMNS, compared, left_out
    from experiment_runner.report.overview import FEW
    from experiment_runner.report.tables import format_table, terminal_width
    from experiment_runner.store.results import Results

    with Results.open(first) as a, Results.open(second) as b:
        rows, notes = compared(a, b, over), left_out(a, b)
    if as_json:
        click.echo(json.dumps([row.as_json() for row in rows], indent=2))
    else:
        click.echo(format_table(COLUMNS, [row.cells() for row in rows], width=terminal_width()))
        if any(row.found.trials < FEW_TRIALS for row in rows):
            click.echo(f"({FEW.strip()} fewer than {FEW_TRIALS} trials: their intervals are too narrow)")
    _say_all(notes)


@results.command("table")
@click.argument("directories", metavar="RUN...", nargs=-1, required=True, type=_directory)
@click.option(
    "--format",
    "kind",
    type=click.Choice(["latex", "markdown"]),
    default="markdown",
    show_default=True,
    help="For LaTeX, with the package booktabs, or for Markdown.",
)
@over_option
@select_option
def table_command(directories: tuple[Path, ...], kind: str, over: str, select: tuple[str, ...]) -> None:
    """Write the table of a paper: a row for each agent, a column for each environment of each RUN.

    A cell is the mean over trials, with its 95 % bootstrap interval, of the mean return of the last 100
    episodes or, over steps, of the last tenth; as in glue-results show.

    \b
    Examples:
      glue-results table runs/sweep --format latex > table.tex
      glue-results table runs/mine runs/other --select sarsa
    """
    from experiment_runner.analysis.settings import collect
    from experiment_runner.report.markup import LATEX, MARKDOWN, paper_table
    from experiment_runner.store.results import Results

    with ExitStack() as stack:
        runs = [stack.enter_context(Results.open(directory)) for directory in directories]
        settings = selected(collect(runs), select)
    click.echo(paper_table(settings, over, LATEX if kind == "latex" else MARKDOWN))


@results.command()
@click.argument("directory", metavar="RUN", type=_directory)
@click.option("--difference", type=float, required=True, metavar="D", help="Difference of the mean returns.")
@click.option(
    "--power",
    "chance",
    type=click.FloatRange(0, 1, min_open=True, max_open=True),
    default=0.8,
    show_default=True,
    help="Probability with which it is to be seen.",
)
@over_option
def power(directory: Path, difference: float, chance: float, over: str) -> None:
    """Show how many trials of two agents are needed to detect a difference D, from a pilot RUN.

    D is detected if the 95 % interval of Welch's t-test excludes 0; comparisons are simulated from the trials
    of each setting.

    \b
    Examples:
      glue-results power runs/pilot --difference 10
    """
    from experiment_runner.report.comparing import left_out, needed
    from experiment_runner.report.tables import format_table, terminal_width
    from experiment_runner.store.results import Results

    if difference == 0:
        raise ConfigError("--difference is not 0")
    with Results.open(directory) as found:
        rows, notes = needed(found, difference, chance, over), left_out(found)
    click.echo(
        format_table(("setting", "pilot trials", "trials of each agent"), rows, width=terminal_width())
    )
    _say_all(notes)


@results.command()
@click.argument("directory", metavar="RUN", type=_directory)
@over_option
def sensitivity(directory: Path, over: str) -> None:
    """Show how sensitive each agent of a sweep over several environments is to its options.

    The sensitivity is the loss from using one configuration for all environments instead of the best one of
    each, in scores that are normalised in each environment (Adkins et al. 2024).

    \b
    Examples:
      glue-results sensitivity runs/sweep
    """
    from experiment_runner.report.comparing import left_out, sensitivities
    from experiment_runner.report.tables import format_table, terminal_width
    from experiment_runner.store.results import Results

    with Results.open(directory) as found:
        rows, notes = sensitivities(found, over), left_out(found)
    columns = ("agent", "configurations", "environments", "sensitivity", "best on average")
    click.echo(format_table(columns, rows, width=terminal_width(), prose=True))
    _say_all(notes)


@results.command()
@click.argument("directories", metavar="RUN...", nargs=-1, required=True, type=_directory)
@click.option("--out", required=True, type=_directory, help="Directory of the new run.")
def merge(directories: tuple[Path, ...], out: Path) -> None:
    """Merge runs into a new one; the originals stay unchanged.

    Runs of the same plan, from different machines, become a run of that plan, which glue-experiment
    --resume completes if episodes are missing. Runs of different plans become a run for viewing only.

    \b
    Examples:
      glue-results merge runs/lab1 runs/lab2 --out runs/both
    """
    from experiment_runner.store.merge import merge as merge_runs
    from experiment_runner.store.results import Results

    with ExitStack() as stack, naming_out():
        merge_runs([stack.enter_context(Results.open(directory)) for directory in directories], out)
    say(f"wrote {out}")


@results.command()
@click.argument("directory", metavar="RUN", type=_directory)
def gather(directory: Path) -> None:
    """Move the results of a job array to its RUN; the array's last job does this automatically.

    \b
    Examples:
      glue-results gather runs/sweep
    """
    from experiment_runner.cli.arrays import gather_run

    gather_run(directory)


@results.command()
@click.argument("directory", metavar="RUN", type=_directory)
@click.option(
    "--to",
    "logger",
    type=click.Choice([*LOGGERS]),
    required=True,
    help="The program that shows the results.",
)
@click.option(
    "--project",
    metavar="NAME",
    default="glue-rl",
    show_default=True,
    help="Its project or, in MLflow, experiment. TensorBoard has none.",
)
def stream(directory: Path, logger: str, project: str) -> None:
    """Send the results of a RUN to TensorBoard, W&B, MLflow or Trackio, also while the run is in progress.

    Each trial becomes a run there, over its steps. Run again, the same command continues where it stopped.

    \b
    Examples:
      glue-results stream runs/mine --to tensorboard
      WANDB_MODE=offline glue-results stream runs/mine --to wandb --project mario
      MLFLOW_TRACKING_URI=http://localhost:5000 glue-results stream runs/mine --to mlflow
    """
    from experiment_runner.loggers.stream import stream as send
    from experiment_runner.report.tables import counted
    from experiment_runner.store.layout import STREAMS

    say(f"sent {counted(send(directory, logger, project), 'episode')} of {directory} to {logger}")
    if logger == "tensorboard":
        say(f"look at them with: tensorboard --logdir {directory / STREAMS / logger}")


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
    """Write the agent of a RUN, from the newest checkpoint of its trial, to a file.

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


def _step_table(found: Results, every: int | None) -> Table:
    """Return the table of the mean return of the episodes under way, every `every` steps."""
    import numpy as np

    from experiment_runner.analysis.settings import collect
    from experiment_runner.store.export import table_of

    totals = {
        name: trial for setting in collect([found]) for name, trial in setting.totals_by_trial().items()
    }
    step = every or max(1, max((int(trial.steps[-1]) for trial in totals.values()), default=0) // 100)

    def rows(spec: TrialSpec) -> Iterator[list[Cell]]:
        if (trial := totals.get(spec.id)) is not None:
            at = np.arange(step, trial.steps[-1] + 1, step)
            for end, value in zip(at, trial.mean(at, step), strict=True):
                yield [int(end), float(value)]

    return table_of(found, {"trial": str, "step": int, "return": float}, rows)


def _trial(found: Results, trial_id: str | None) -> TrialRecord:
    trials: dict[str, TrialRecord] = {trial.spec.id: trial for trial in found.trials()}
    if trial_id is None:
        if not trials:
            raise ExperimentError(f"{found.directory} has no trials")
        if len(trials) > 1:
            raise ConfigError(
                f"{found.directory} has {len(trials)} trials: name one, as in --trial {next(iter(trials))}"
            )
        return next(iter(trials.values()))
    named = {name: trials[identifier] for identifier, name in found.trial_names().items()} | trials
    if trial_id not in named:
        raise ConfigError(f"{found.directory} has no trial {trial_id}{did_you_mean(trial_id, named)}")
    return named[trial_id]


def _why_unsaved(found: Results, trial: TrialRecord) -> str:
    from experiment_runner.plan.plan import length_of

    reasons = [e.text for e in found.events() if e.kind == "unsaved" and e.trial_id == trial.spec.id]
    if reasons:
        return f"{trial.spec.id} has no checkpoint: {reasons[-1]}"
    if trial.finished:  # players that can be saved are saved at the end
        return f"{trial.spec.id} has no checkpoint: its agent or environment cannot save itself"
    return (
        f"{trial.spec.id} has no checkpoint yet, after {trial.done} of {length_of(trial.spec)}: "
        "one is written at its end, and before that as often as --checkpoint-every says"
    )


def _say_all(lines: Iterable[str]) -> None:
    for line in lines:
        say(f"note: {line}")
