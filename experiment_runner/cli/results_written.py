"""Subcommands of `glue-results` that write or remove: export, merge, gather, stream, agent, remove."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import click
import numpy as np

from experiment_runner.analysis.settings import collect
from experiment_runner.cli.options import RUN, RUNS, naming_out, over_option
from experiment_runner.loggers import LOGGERS
from experiment_runner.plan.plan import TrialSpec, length_of
from experiment_runner.report.tables import counted
from experiment_runner.store import run_data
from experiment_runner.store.database import reported
from experiment_runner.store.layout import STREAMS, remove_run
from experiment_runner.store.merge import merge as merge_runs
from experiment_runner.store.records import TrialRecord
from experiment_runner.store.results import Results, opened
from glue.cli.shared import DIRECTORY, FILE
from glue.console import did_you_mean, say
from glue.errors import ConfigError, ExperimentError


@click.command()
@RUN
@click.option(
    "--format", "kind", type=click.Choice(["csv", "json", "parquet"]), default="csv", show_default=True
)
@click.option("--out", type=FILE, help="File. [default: standard output]")
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
    if metrics and over == "steps":
        raise ConfigError("metrics have a row for each value: leave out --over steps")
    if every is not None and over != "steps":
        raise ConfigError("--every counts steps: add --over steps")
    with Results.open(directory) as found:
        if metrics:
            table = run_data.metric_table(found)
        else:
            table = run_data.episode_table(found) if over == "episodes" else _step_table(found, every)
        if kind == "parquet":
            if out is None:
                raise ConfigError(
                    "Parquet is binary and cannot go to standard output: name a file with --out FILE"
                )
            run_data.write_parquet(table, out)
            say(f"wrote {out}")
            return
        write = run_data.write_csv if kind == "csv" else run_data.write_json
        if out is None:
            with reported("cannot write the table"):
                write(table, sys.stdout)
                sys.stdout.flush()
            return
        with run_data.written(out) as partial, partial.open("w", encoding="utf-8", newline="") as file:
            write(table, file)
    say(f"wrote {out}")


@click.command()
@RUNS
@click.option("--out", required=True, type=DIRECTORY, help="Directory of the new run.")
def merge(directories: tuple[Path, ...], out: Path) -> None:
    """Merge runs into a new one; the originals stay unchanged.

    Runs of the same plan, from different machines, become a run of that plan, which glue-experiment
    --resume completes if episodes are missing. Runs of different plans become a run for viewing only.

    \b
    Examples:
      glue-results merge runs/lab1 runs/lab2 --out runs/both
    """
    with opened(directories) as runs, naming_out():
        merge_runs(runs, out)
    say(f"wrote {out}")


@click.command()
@RUN
def gather(directory: Path) -> None:
    """Move the results of a job array to its RUN; the array's last job does this automatically.

    \b
    Examples:
      glue-results gather runs/sweep
    """
    from experiment_runner.cli.run_plan import gather_run  # slow to import

    gather_run(directory)


@click.command()
@RUN
@click.option(
    "--to", "logger", type=click.Choice([*LOGGERS]), required=True, help="The program that shows the results."
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

    say(f"sent {counted(send(directory, logger, project), 'episode')} of {directory} to {logger}")
    if logger == "tensorboard":
        say(f"look at them with: tensorboard --logdir {directory / STREAMS / logger}")


@click.command()
@RUN
@click.option("--trial", "trial_id", metavar="ID", help="The trial; not needed if the run has one only.")
@click.option(
    "--out",
    "-o",
    required=True,
    type=FILE,
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
    with Results.open(directory) as found:
        trial = _trial(found, trial_id)
        checkpoint = found.checkpoint(trial.spec.id)
        if checkpoint is None:
            raise ExperimentError(_why_unsaved(found, trial))
    episode, saved = checkpoint
    with run_data.written(out) as partial:
        partial.write_bytes(saved.agent)
    say(f"wrote {out}: the agent of {trial.spec.id} after {counted(episode, 'episode')}")


@click.command()
@RUNS
@click.option("--yes", "-y", is_flag=True, help="Do not ask for confirmation.")
def remove(directories: tuple[Path, ...], yes: bool) -> None:
    """Remove each RUN, after confirmation.

    Only the files of the run are removed; other files in its directory, such as recordings, are kept.

    \b
    Examples:
      glue-results remove runs/mistake
      glue-results remove runs/20260101-120000-jumper-mines --yes
    """
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


def _step_table(found: Results, every: int | None) -> run_data.Table:
    """Return the table of the mean return of the episodes under way, every `every` steps."""
    totals = {
        name: trial for setting in collect([found]) for name, trial in setting.totals_by_trial().items()
    }
    step = every or max(1, max((int(trial.steps[-1]) for trial in totals.values()), default=0) // 100)

    def rows(spec: TrialSpec) -> Iterator[list[run_data.Cell]]:
        if (trial := totals.get(spec.id)) is not None:
            at = np.arange(step, trial.steps[-1] + 1, step)
            for end, value in zip(at, trial.mean(at, step), strict=True):
                yield [int(end), float(value)]

    return run_data.table_of(found, {"trial": str, "step": int, "return": float}, rows)


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

    reasons = [e.text for e in found.events() if e.kind == "unsaved" and e.trial_id == trial.spec.id]
    if reasons:
        return f"{trial.spec.id} has no checkpoint: {reasons[-1]}"
    if trial.finished:  # players that can be saved are saved at the end
        return f"{trial.spec.id} has no checkpoint: its agent or environment cannot save itself"
    return (
        f"{trial.spec.id} has no checkpoint yet, after {trial.done} of {length_of(trial.spec)}: "
        "one is written at its end, and before that as often as --checkpoint-every says"
    )
