"""The state and results of a run, in one line or in full: for people, and as JSON for scripts."""

from __future__ import annotations

import math
import textwrap
from collections import Counter, defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, ClassVar, Final

import numpy as np

from experiment_runner.analysis import stats
from experiment_runner.analysis.settings import Setting, collect
from experiment_runner.report.tables import counted, decimal, format_table, wrap
from experiment_runner.store.layout import lock_holder
from experiment_runner.store.records import OF_PLAYERS, TUNED, UNMETERED, UNSEEDED, TrialRecord
from experiment_runner.store.results import Results
from experiment_runner.store.run_data import finite
from glue.console import one_line

_WINDOW: Final = 100
_SETTING_COLUMNS: Final = ("setting", "finished", "episodes", "mean", "95 % interval", "IQM", "converged")
FEW: Final = " (!)"
"""Mark of an interval of few trials."""
_LEGEND: Final = {
    "mean, IQM": f"over trials, of the mean return of the last {_WINDOW} episodes; "
    "IQM is the interquartile mean",
    "interval": "of the mean, by bootstrap",
    "converged": f"the episode from which the mean of {_WINDOW}, over all trials, "
    "stays within 2 of its final value",
}
_STEPS_LEGEND: Final = {
    "mean, IQM": "over trials, of the last tenth of the steps, each with the return of the episode under "
    "way; IQM is the interquartile mean",
    "converged": "not determined over steps",
}
_LEGEND_WIDTH: Final = 100


def _descending(name: str) -> Callable[[Mapping[str, Any]], float]:
    return lambda numbers: math.inf if numbers[name] is None else -float(numbers[name])


SORT_KEYS: Final[Mapping[str, Callable[[Mapping[str, Any]], Any]]] = {
    "setting": lambda numbers: numbers["setting"],
    "mean": _descending("mean"),
    "IQM": _descending("interquartile_mean"),
    "converged": lambda numbers: math.inf if numbers["converged"] is None else numbers["converged"],
}
"""Orders of the settings in `as_text`, by column: names and episodes ascending, returns descending."""


@dataclass(frozen=True, slots=True)
class Overview:
    """A run in one line.

    directory  of the run
    started    seconds since 1970, UTC; None if not recorded
    trials     number of finished trials, and of all
    episodes   number of recorded episodes, and of planned ones
    steps      the same for trials with a budget of steps; 0 and 0 if there are none
    state      running, failed, finished or interrupted
    reason     the process that runs it, or the failure of the first failed trial; otherwise empty
    """

    COLUMNS: ClassVar = ("run", "started", "trials", "episodes", "state", "reason")

    directory: Path
    started: float | None
    trials: tuple[int, int]
    episodes: tuple[int, int]
    steps: tuple[int, int]
    state: str
    reason: str

    def cells(self) -> tuple[str, ...]:
        """Return the cell of each of `COLUMNS`."""
        length = "{:,}/{:,} steps".format(*self.steps) if self.steps[1] else "{}/{}".format(*self.episodes)
        counts = ("{}/{}".format(*self.trials), length)
        return (str(self.directory), date(self.started), *counts, self.state, self.reason)

    def as_json(self) -> dict[str, object]:
        """Return the overview as a JSON object."""
        return {
            "run": str(self.directory),
            "started": self.started,
            "finished_trials": self.trials[0],
            "trials": self.trials[1],
            "episodes": self.episodes[0],
            "planned_episodes": self.episodes[1],
            **({"steps": self.steps[0], "planned_steps": self.steps[1]} if self.steps[1] else {}),
            "state": self.state,
            "reason": self.reason,
        }


def overview(results: Results) -> Overview:
    """Return the overview of a run.

    Raises:
        ExperimentError: the run cannot be read.
    """
    trials = results.trials()
    # A trial of a competition ends with its steps or a forfeit, whatever its planned number of episodes.
    ended = {trial.spec.id for trial in trials if trial.finished} | results.outcomes().keys()
    starts = [event.time for event in results.events() if event.kind == "start"]
    return Overview(
        results.directory,
        starts[0] if starts else None,
        (len(ended), len(trials)),
        (
            sum(trial.done for trial in trials),
            sum(trial.done if trial.spec.id in ended else trial.spec.episodes for trial in trials),
        ),
        (sum(trial.steps for trial in trials), sum(trial.spec.steps for trial in trials)),
        *_state(results.directory, trials, len(ended) == len(trials), results.trial_names()),
    )


def _legend(width: int, over: str) -> list[str]:
    """Return the lines that explain the columns."""
    margin = max(map(len, _LEGEND)) + 2
    legend = _LEGEND if over == "episodes" else _LEGEND | _STEPS_LEGEND
    return [
        textwrap.fill(f"{term:<{margin}}{text}", max(width, 2 * margin), subsequent_indent=" " * margin)
        for term, text in legend.items()
    ]


def as_text(
    runs: Sequence[Results], width: int | None = None, sort: str | None = None, over: str = "episodes"
) -> str:
    """Return the results of some runs: a line for each setting, then failures, voids and events.

    Args:
        runs: open for reading.
        width: see `format_table`.
        sort: key of `SORT_KEYS`; None for the order of the plans.
        over: `episodes` or `steps`.

    Raises:
        ExperimentError: a run cannot be read.
    """
    numbers = setting_numbers(collect(runs), over)
    if sort is not None:
        numbers.sort(key=SORT_KEYS[sort])
    rows = [_cells(row) for row in numbers]
    lines = [wrap(line, width) for run in runs for line in _header(run)]
    legend = _legend(width or _LEGEND_WIDTH, over)
    lines += ["", format_table(_SETTING_COLUMNS, rows, width=width), "", *legend]
    if metrics := [row for run in runs for row in metric_rows(run)]:
        lines += ["", format_table(("metric", "trials", "values", "last"), metrics, width=width)]
    notes = []
    if any(cells[4].endswith(FEW) for cells in rows):
        notes.append(f"({FEW.strip()} of fewer than {stats.FEW_TRIALS} trials: they may well miss the mean)")
    for run in runs:
        notes += _notes(run)
    return "\n".join([*lines, *(wrap(one_line(note), width) for note in notes)])


def _header(results: Results) -> list[str]:
    run = overview(results)
    lines = [
        f"{one_line(str(run.directory))}: {run.state}"
        + (f" ({one_line(run.reason)})" if run.state == "running" else "")
    ]
    if run.started is not None:
        lines.append(f"started  {date(run.started)}")
    programs = ", then ".join(_programs(results))
    return [*lines, f"program  {one_line(programs)}"] if programs else lines


def _notes(results: Results) -> list[str]:
    names = results.trial_names()
    failed = [trial for trial in results.trials() if trial.failure is not None]
    notes = [f"failed: {names[trial.spec.id]}: {trial.failure}" for trial in failed]
    if shorter := sum(not trial.finished for trial in failed):
        notes.append(f"{counted(shorter, 'failed trial')} left out of the means")
    notes += [f"void: episode {v.episode} of {names[v.trial_id]}: {v.why}" for v in results.voids()]
    if cut := sum(results.cut_by_budget(trial.spec.id) for trial in results.trials() if trial.spec.steps):
        notes.append(f"the budget of steps has cut off the last episode of {counted(cut, 'trial')}")
    alike: dict[tuple[str, str], dict[str, None]] = defaultdict(dict)
    for event in results.events():
        if event.kind in OF_PLAYERS and event.trial_id is not None:
            alike[event.kind, event.text][names[event.trial_id]] = None
        elif event.trial_id is not None:
            notes.append(f"{event.kind}: {names[event.trial_id]}: {event.text}")
        elif event.kind in (UNSEEDED, UNMETERED, TUNED):
            notes.append(event.text)
    for (kind, text), (first, *others) in alike.items():
        more = f" and {counted(len(others), 'other trial')}" if others else ""
        notes.append(f"{kind}: {first}{more}: {text}")
    return notes


def as_object(results: Results, over: str = "episodes") -> dict[str, object]:
    """Return the results of a run as a JSON object; numbers that are not available are None.

    Raises:
        ExperimentError: the run cannot be read.
    """
    names, numbers = results.trial_names(), setting_numbers(collect([results]), over)
    return {
        **overview(results).as_json(),
        "programs": _programs(results),
        "settings": [{k: finite(v) for k, v in setting.items()} for setting in numbers],
        "trial_records": [
            {
                "trial": trial.spec.id,
                "name": names[trial.spec.id],
                "seed": trial.spec.seed,
                "episodes": trial.done,
                "planned_episodes": trial.spec.episodes,
                "planned_steps": trial.spec.steps,
                "cut_by_budget": results.cut_by_budget(trial.spec.id),
                "voids": trial.voids,
                "failure": trial.failure,
            }
            for trial in results.trials()
        ],
        "metrics": results.metric_names(),
        "voids": [void._asdict() for void in results.voids()],
        "events": [event._asdict() for event in results.events()],
        "answers": [answered._asdict() for answered in results.newest_answers()],
    }


def metric_rows(results: Results) -> list[tuple[str, str, str, str]]:
    """Return a row for each metric: its name, numbers of trials and of values, and the mean last value."""
    last: dict[str, list[float]] = defaultdict(list)
    counts: Counter[str] = Counter()
    for trial in results.trials():
        for name, metric in results.metrics(trial.spec.id).items():
            last[name].append(metric.values[-1])
            counts[name] += metric.values.size
    return [
        (name, f"{len(last[name])}", f"{counts[name]}", f"{np.mean(last[name]):.6g}") for name in sorted(last)
    ]


def setting_numbers(settings: Sequence[Setting], over: str = "episodes") -> list[dict[str, object]]:
    """Return the row of each setting in the table of results; values that are not available yet are None.

    Args:
        settings: of returns.
        over: `episodes` or `steps`.
    """
    rng = stats.bootstrap_rng()
    return [_numbers(setting, over, rng) for setting in settings]


def _state(
    directory: Path, trials: list[TrialRecord], ended: bool, names: Mapping[str, str]
) -> tuple[str, str]:
    holder = lock_holder(directory)
    if holder is not None:
        return "running", holder
    failures = [f"{names[t.spec.id]}: {t.failure}" for t in trials if t.failure is not None]
    if failures:
        more = f" (and {len(failures) - 1} more)" if len(failures) > 1 else ""
        return "failed", failures[0] + more
    return "finished" if ended else "interrupted", ""


def date(time: float | None) -> str:
    """Return a time in seconds since 1970 as a date in UTC; empty for None."""
    return "" if time is None else datetime.fromtimestamp(time, UTC).strftime("%Y-%m-%d %H:%M UTC")


def _programs(results: Results) -> list[str]:
    """Return the distinct versions of the program that executed a run."""
    return list(dict.fromkeys(e.text for e in results.events() if e.kind in ("start", "resume")))


def _numbers(setting: Setting, over: str, rng: np.random.Generator) -> dict[str, object]:
    begun = [
        values
        for trial, values in zip(setting.trials, setting.values, strict=True)
        if values.size and (trial.finished or trial.failure is None)
    ]
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
        "few_trials": len(begun) < stats.FEW_TRIALS,
    }
    if begun:
        if over == "steps":
            totals = setting.step_totals()
            reached = np.array([trial.last(max(1, int(trial.steps[-1]) // 10)) for trial in totals])
        else:
            reached = np.array([stats.mean_of_last(returns, _WINDOW) for returns in begun])
            numbers["converged"] = stats.convergence_episode(stats.mean(setting.curves()), _WINDOW)
        numbers["mean"] = float(stats.mean(reached))
        _, low, high = stats.estimate([reached], stats.mean, rng)
        if not np.isnan(low):
            numbers |= {"low": float(low), "high": float(high)}
        numbers["interquartile_mean"] = float(stats.interquartile_mean(reached))
    return numbers


def _cells(numbers: Mapping[str, Any]) -> tuple[str, ...]:
    low, high = numbers["low"], numbers["high"]
    few = FEW if numbers["few_trials"] else ""
    return (
        str(numbers["setting"]),
        f"{numbers['finished_trials']}/{numbers['trials']}",
        str(numbers["episodes"]),
        _number(numbers["mean"]),
        "-" if low is None or high is None else f"{decimal(low)} to {decimal(high)}{few}",
        _number(numbers["interquartile_mean"]),
        "-" if numbers["converged"] is None else str(numbers["converged"]),
    )


def _number(value: float | None) -> str:
    return "-" if value is None else decimal(value)
