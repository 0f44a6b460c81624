"""The state and results of a run, in one line and in full: for people, and as JSON for scripts."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import ClassVar, Final

import numpy as np

from experiment_runner.analysis.settings import Setting, collect
from experiment_runner.analysis.stats import (
    bootstrap_rng,
    convergence_episode,
    estimate,
    has_scipy,
    interquartile_mean,
    mean,
    mean_of_last,
)
from experiment_runner.lock import lock_holder
from experiment_runner.report.tables import format_table, one_line, wrap
from experiment_runner.store.joined import trial_names
from experiment_runner.store.output import finite
from experiment_runner.store.records import TrialRecord
from experiment_runner.store.results import Results

__all__ = ["Overview", "as_object", "as_text", "overview", "setting_numbers"]

_WINDOW: Final = 100
_SETTING_COLUMNS: Final = ("setting", "finished", "episodes", "mean", "95 % interval", "IQM", "converged")
_LEGEND: Final = {
    "mean, IQM": f"over trials, of the mean return of the last {_WINDOW} episodes; "
    "IQM is the interquartile mean",
    "interval": "of the mean, by bootstrap",
    "converged": f"the episode from which the mean of {_WINDOW}, over all trials, "
    "stays within 2 of its final value",
}
_LEGEND_WIDTH: Final = 100


@dataclass(frozen=True, slots=True)
class Overview:
    """A run in one line.

    directory  of the run
    started    seconds since 1970, UTC; None if not recorded
    trials     how many are finished, and how many there are in all
    episodes   how many are recorded, and how many are planned
    state      running, failed, finished or interrupted
    reason     which process runs it, or why the first failed trial failed; otherwise empty
    """

    COLUMNS: ClassVar = ("run", "started", "trials", "episodes", "state", "reason")

    directory: Path
    started: float | None
    trials: tuple[int, int]
    episodes: tuple[int, int]
    state: str
    reason: str

    def cells(self) -> tuple[str, ...]:
        """Return the cell of each of `COLUMNS`."""
        counts = ("{}/{}".format(*self.trials), "{}/{}".format(*self.episodes))
        return (str(self.directory), _date(self.started), *counts, self.state, self.reason)

    def as_json(self) -> dict[str, object]:
        """Return the overview as a JSON object."""
        return {
            "run": str(self.directory),
            "started": self.started,
            "finished_trials": self.trials[0],
            "trials": self.trials[1],
            "episodes": self.episodes[0],
            "planned_episodes": self.episodes[1],
            "state": self.state,
            "reason": self.reason,
        }


def overview(results: Results) -> Overview:
    """Return the overview of a run.

    Raises:
        ExperimentError: the run cannot be read.
    """
    trials = results.trials()
    starts = [event.time for event in results.events() if event.kind == "start"]
    return Overview(
        results.directory,
        starts[0] if starts else None,
        (sum(trial.finished for trial in trials), len(trials)),
        (sum(trial.done for trial in trials), sum(trial.spec.episodes for trial in trials)),
        *_state(results.directory, trials, trial_names(results)),
    )


def _legend(width: int) -> list[str]:
    """Return the lines that explain the columns."""
    margin = max(map(len, _LEGEND)) + 2
    return [
        textwrap.fill(f"{term:<{margin}}{text}", max(width, 2 * margin), subsequent_indent=" " * margin)
        for term, text in _LEGEND.items()
    ]


def as_text(results: Results, width: int | None = None) -> str:
    """Return the results of a run: a line for each setting, then failures, voids and events.

    Args:
        results: of the run.
        width: see `format_table`.

    Raises:
        ExperimentError: the run cannot be read.
    """
    run = overview(results)
    header = [f"{run.directory}: {run.state}" + (f" ({run.reason})" if run.state == "running" else "")]
    if run.started is not None:
        header.append(f"started  {_date(run.started)}")
    programs = ", then ".join(_programs(results))
    if programs:
        header.append(f"program  {one_line(programs)}")
    rows = [_cells(numbers) for numbers in setting_numbers(collect([results]))]
    table = ["", format_table(_SETTING_COLUMNS, rows, width=width), "", *_legend(width or _LEGEND_WIDTH)]
    notes = []
    if not has_scipy():
        notes.append("(intervals and IQM need SciPy: pip install 'glue-rl[plot]')")
    names = trial_names(results)
    failed = [trial for trial in results.trials() if trial.failure is not None]
    notes += [f"failed: {names[trial.spec.id]}: {trial.failure}" for trial in failed]
    notes += [f"void: episode {v.episode} of {names[v.trial_id]}: {v.why}" for v in results.voids()]
    notes += [f"{e.kind}: {names[e.trial_id]}: {e.text}" for e in results.events() if e.trial_id]
    notes = [wrap(one_line(note), width) for note in notes]
    return "\n".join([*(wrap(line, width) for line in header), *table, *notes])


def as_object(results: Results) -> dict[str, object]:
    """Return the results of a run as a JSON object; numbers that are not available are None.

    Raises:
        ExperimentError: the run cannot be read.
    """
    names = trial_names(results)
    return {
        **overview(results).as_json(),
        "programs": _programs(results),
        "settings": [
            {k: finite(v) for k, v in setting.items()} for setting in setting_numbers(collect([results]))
        ],
        "trial_records": [
            {
                "trial": trial.spec.id,
                "name": names[trial.spec.id],
                "seed": trial.spec.seed,
                "episodes": trial.done,
                "planned_episodes": trial.spec.episodes,
                "voids": trial.voids,
                "failure": trial.failure,
            }
            for trial in results.trials()
        ],
        "voids": [void._asdict() for void in results.voids()],
        "events": [event._asdict() for event in results.events()],
        "answers": [answered._asdict() for answered in results.newest_answers()],
    }


def setting_numbers(settings: Sequence[Setting]) -> list[dict[str, object]]:
    """Return the line of each setting in the table of results; what is not available yet is None."""
    rng = bootstrap_rng()
    return [_numbers(setting, rng) for setting in settings]


def _state(directory: Path, trials: list[TrialRecord], names: Mapping[str, str]) -> tuple[str, str]:
    holder = lock_holder(directory)
    if holder is not None:
        return "running", holder
    failures = [f"{names[t.spec.id]}: {t.failure}" for t in trials if t.failure is not None]
    if failures:
        more = f" (and {len(failures) - 1} more)" if len(failures) > 1 else ""
        return "failed", failures[0] + more
    return "finished" if all(trial.finished for trial in trials) else "interrupted", ""


def _date(time: float | None) -> str:
    return "" if time is None else datetime.fromtimestamp(time, UTC).strftime("%Y-%m-%d %H:%M UTC")


def _programs(results: Results) -> list[str]:
    """Return the distinct versions of the program that executed a run."""
    return list(dict.fromkeys(e.text for e in results.events() if e.kind in ("start", "resume")))


def _numbers(setting: Setting, rng: np.random.Generator) -> dict[str, object]:
    begun = [returns for returns in setting.returns if returns.size]
    numbers: dict[str, object] = {
        "setting": setting.label,
        "finished_trials": sum(trial.finished for trial in setting.trials),
        "trials": len(setting.trials),
        "episodes": sum(map(len, begun)),
        "mean": None,
        "low": None,
        "high": None,
        "interquartile_mean": None,
        "converged": None,
    }
    if begun:
        reached = np.array([mean_of_last(returns, _WINDOW) for returns in begun])
        numbers["mean"] = float(mean(reached))
        numbers["converged"] = convergence_episode(mean(setting.curves()), _WINDOW)
        if has_scipy():
            _, low, high = estimate([reached], mean, rng)
            if not np.isnan(low):
                numbers |= {"low": float(low), "high": float(high)}
            numbers["interquartile_mean"] = float(interquartile_mean(reached))
    return numbers


def _cells(numbers: dict[str, object]) -> tuple[str, ...]:
    low, high = numbers["low"], numbers["high"]
    return (
        str(numbers["setting"]),
        f"{numbers['finished_trials']}/{numbers['trials']}",
        str(numbers["episodes"]),
        _number(numbers["mean"]),
        "-" if low is None or high is None else f"{low:.2f} to {high:.2f}",
        _number(numbers["interquartile_mean"]),
        "-" if numbers["converged"] is None else str(numbers["converged"]),
    )


def _number(value: object) -> str:
    return "-" if value is None else f"{value:.2f}"
