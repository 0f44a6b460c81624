"""`glue-results`: list runs, show one, export and merge them, take an agent out."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from datetime import UTC, datetime
from pathlib import Path
from typing import Final

import click
import numpy as np

from experiment_runner.analysis.settings import Setting, collect
from experiment_runner.analysis.stats import (
    convergence_episode,
    estimate,
    has_scipy,
    interquartile_mean,
    mean,
    mean_of_last,
)
from experiment_runner.report.tables import format_table
from experiment_runner.store.database import DATABASE_FILES, reported
from experiment_runner.store.export import write_csv, write_json, write_parquet
from experiment_runner.store.lock import lock_holder
from experiment_runner.store.merge import merge as merge_runs
from experiment_runner.store.output import written
from experiment_runner.store.records import TrialRecord
from experiment_runner.store.results import Results
from glue import __version__
from glue.commands import run
from glue.console import say
from glue.errors import ConfigError, ExperimentError
from glue.suggestions import did_you_mean

__all__ = ["main", "results"]

_WINDOW: Final = 100
_SEED: Final = 0  # of the bootstrap: the same run always shows the same interval

_SETTING_COLUMNS: Final = ("setting", "finished", "episodes", "mean", "95 % interval", "IQM", "converged")
_LEGEND: Final = f"""\
mean, IQM  over trials, of the mean of their last {_WINDOW} episodes; IQM is the interquartile mean
interval   of the mean, by bootstrap
converged  the episode from which the mean of {_WINDOW}, over all trials, stays within 2 of its end"""

_directory = click.Path(path_type=Path, file_okay=False)


@click.group()
@click.version_option(__version__, prog_name="glue-results")
def results() -> None:
    """Look at the results of experiments, also while they run.

    A run is the directory that glue-experiment made (its --out).

    \b
    Examples:
      glue-results list
      glue-results show runs/mine
      glue-results export runs/mine --out mine.csv
      glue-results merge runs/lab1 runs/lab2 --out runs/both
      glue-results agent runs/mine --out mine.agent
    """


@results.command("list")
@click.argument("folder", type=_directory, default="runs")
def list_runs(folder: Path) -> int:
    """List the runs in FOLDER (by default runs) and the folders within.

    \b
    Examples:
      glue-results list
      glue-results list /data/mario
    """
    rows: list[tuple[str, ...]] = []
    unreadable: list[str] = []
    for directory in _runs_under(folder):
        try:
            with Results.open(directory) as found:
                trials = found.trials()
                rows.append(
                    (
                        str(directory),
                        _started(found),
                        f"{sum(trial.finished for trial in trials)}/{len(trials)}",
                        f"{sum(trial.done for trial in trials)}/{sum(t.spec.episodes for t in trials)}",
                        _state(directory, trials),
                    )
                )
        except ExperimentError as error:
            unreadable.append(str(error))
    if rows:
        click.echo(format_table(("run", "started", "trials", "episodes", "state"), rows))
    elif not unreadable:
        say(f"there are no runs in {folder}")
    for line in unreadable:
        say(f"Error: {line}")
    return 1 if unreadable else 0


@results.command()
@click.argument("directory", metavar="RUN", type=_directory)
def show(directory: Path) -> None:
    """Show what a RUN has come to: a line for each setting, and what went wrong.

    \b
    Examples:
      glue-results show runs/mine
    """
    with Results.open(directory) as found:
        trials = found.trials()
        click.echo(f"{directory}: {_state(directory, trials)}")
        for name, text in (("started", _started(found)), ("program", _program(found))):
            if text:
                click.echo(f"{name}  {text}")
        rng = np.random.default_rng(_SEED)
        rows = [_setting_row(setting, rng) for setting in collect([found])]
        click.echo("\n" + format_table(_SETTING_COLUMNS, rows) + "\n\n" + _LEGEND)
        if not has_scipy():
            click.echo("(intervals and IQM need SciPy: pip install 'glue-rl[plot]')")
        for trial in trials:
            if trial.failure is not None:
                click.echo(f"failed: {trial.spec.id}: {trial.failure}")
        for void in found.voids():
            click.echo(f"void: episode {void.episode} of {void.trial_id}: {void.why}")
        for event in found.events():
            if event.trial_id is not None:
                click.echo(f"{event.kind}: {event.trial_id}: {event.text}")


@results.command()
@click.argument("directory", metavar="RUN", type=_directory)
@click.option(
    "--format", "kind", type=click.Choice(["csv", "json", "parquet"]), default="csv", show_default=True
)
@click.option(
    "--out", type=click.Path(path_type=Path, dir_okay=False), help="File. [default: standard output]"
)
def export(directory: Path, kind: str, out: Path | None) -> None:
    """Write the episodes of a RUN as one table: trial, episode, return, steps, terminal, ...

    An episode is a row; each option of agent and environment is a column. Parquet needs --out.

    \b
    Examples:
      glue-results export runs/mine --format csv --out mine.csv
      glue-results export runs/mine --format json | jq '.[-1]'
    """
    with Results.open(directory) as found:
        if kind == "parquet":
            if out is None:
                raise ConfigError("a Parquet file is not for the terminal: say where with --out FILE")
            write_parquet(found, out)
            return
        write = write_csv if kind == "csv" else write_json
        if out is None:
            with reported("cannot write the table"):
                write(found, sys.stdout)
                sys.stdout.flush()
            return
        with written(out) as partial, partial.open("w", encoding="utf-8", newline="") as file:
            write(found, file)


@results.command()
@click.argument("directories", metavar="RUN...", nargs=-1, required=True, type=_directory)
@click.option("--out", required=True, type=_directory, help="Directory of the new run.")
def merge(directories: tuple[Path, ...], out: Path) -> None:
    """Make one run of several; they stay as they are.

    Parts of one plan that ran on different machines become a run of that plan, which can go on where
    something is missing (glue-experiment --resume). Other runs become one to look at.

    \b
    Examples:
      glue-results merge runs/lab1 runs/lab2 --out runs/both
    """
    with ExitStack() as stack:
        merge_runs([stack.enter_context(Results.open(directory)) for directory in directories], out)


@results.command()
@click.argument("directory", metavar="RUN", type=_directory)
@click.option("--trial", "trial_id", metavar="ID", help="Of this trial. [default: the only one]")
@click.option(
    "--out",
    "-o",
    required=True,
    type=click.Path(path_type=Path, dir_okay=False),
    metavar="FILE",
    help="File to write; an older one is replaced.",
)
def agent(directory: Path, trial_id: str | None, out: Path) -> None:
    """Write what an agent had learned by the newest checkpoint of its trial in a RUN.

    An agent of the same name and options begins with it: glue-agent NAME --load FILE, glue-watch --load.

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
    with written(out) as partial:
        partial.write_bytes(saved.agent)
    say(f"{out}: the agent of {trial.spec.id} after {episode} episodes")


def _trial(found: Results, trial_id: str | None) -> TrialRecord:
    trials = {trial.spec.id: trial for trial in found.trials()}
    if trial_id is None:
        if len(trials) > 1:
            raise ConfigError(
                f"{found.directory} has {len(trials)} trials: say which, as --trial {next(iter(trials))}"
            )
        return next(iter(trials.values()))
    if trial_id not in trials:
        raise ConfigError(f"{found.directory} has no trial {trial_id}{did_you_mean(trial_id, trials)}")
    return trials[trial_id]


def _why_unsaved(found: Results, trial: TrialRecord) -> str:
    reasons = [e.text for e in found.events() if e.kind == "unsaved" and e.trial_id == trial.spec.id]
    if reasons:
        return f"nothing is saved of {trial.spec.id}: {reasons[-1]}"
    return (
        f"{trial.spec.id} has no checkpoint yet, after {trial.done} of {trial.spec.episodes} episodes: "
        "there is one at its end, and before as often as --checkpoint-every says"
    )


def _runs_under(folder: Path) -> Iterator[Path]:
    if not folder.is_dir():
        raise ConfigError(f"there is no folder {folder}")
    for path, folders, files in os.walk(folder):
        folders.sort()
        if DATABASE_FILES[0] in files:
            folders.clear()
            yield Path(path)


def _state(directory: Path, trials: Sequence[TrialRecord]) -> str:
    holder = lock_holder(directory)
    if holder is not None:
        return f"under way in {holder}"
    failed = sum(trial.failure is not None for trial in trials)
    if failed:
        return f"{failed} failed"
    return "finished" if all(trial.finished for trial in trials) else "interrupted"


def _started(found: Results) -> str:
    for event in found.events():
        if event.kind == "start":
            return datetime.fromtimestamp(event.time, UTC).strftime("%Y-%m-%d %H:%M UTC")
    return ""


def _program(found: Results) -> str:
    starts = [event.text for event in found.events() if event.kind in ("start", "resume")]
    return ", then ".join(dict.fromkeys(starts))


def _setting_row(setting: Setting, rng: np.random.Generator) -> tuple[str, ...]:
    begun = [returns for returns in setting.returns if returns.size]
    cells = [setting.label, f"{sum(t.finished for t in setting.trials)}/{len(setting.trials)}"]
    cells.append(str(sum(map(len, begun))))
    if not begun:
        return (*cells, "-", "-", "-", "-")
    reached = np.array([mean_of_last(returns, _WINDOW) for returns in begun])
    converged = convergence_episode(mean(setting.curves()), _WINDOW)
    interval = middle = "-"
    if has_scipy():
        _, low, high = estimate([reached], mean, rng)
        interval = interval if np.isnan(low) else f"{low:.2f} to {high:.2f}"
        middle = f"{interquartile_mean(reached):.2f}"
    cells += [f"{mean(reached):.2f}", interval, middle]
    return (*cells, "-" if converged is None else str(converged))


def main() -> None:
    """Run `glue-results`."""
    run(results)


if __name__ == "__main__":
    main()
