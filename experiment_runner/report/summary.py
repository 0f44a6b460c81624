"""What an experiment came to, at its end: a table for people, numbers for a script."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from experiment_runner.report.tables import format_table
from experiment_runner.store.records import Totals
from experiment_runner.store.results import Results

__all__ = ["summarize", "tabulate"]

_LAST: Final = 100
_COLUMNS: Final = ("trial", "episodes", "steps", "mean return", f"mean of last {_LAST}", "cut off", "void")


def tabulate(results: Results, seconds: float) -> str:
    """Return a line for each trial, and why it failed if it did."""
    rows, failures = [], []
    for record in results.trials():
        totals = results.totals(record.spec.id)
        means = [_mean([part]) for part in (totals, results.totals(record.spec.id, _LAST))]
        rows.append(
            (
                record.spec.id,
                f"{record.done}/{record.spec.episodes}",
                f"{totals.steps:,}",
                *("-" if mean is None else f"{mean:.2f}" for mean in means),
                f"{totals.cut_off}",
                f"{record.voids}",
            )
        )
        if record.failure is not None:
            failures.append(f"failed: {record.spec.id}: {record.failure}")
    lines = [format_table(_COLUMNS, rows), "", *failures]
    return "\n".join([*lines, f"{seconds:.1f} s; results in {results.directory}"])


def summarize(results: Results, seconds: float) -> dict[str, object]:
    """Return the last line of `--json`; means are None when there is no episode."""
    trials = results.trials()
    totals = [results.totals(trial.spec.id) for trial in trials]
    return {
        "summary": True,
        "episodes": sum(trial.episodes for trial in totals),
        "steps": sum(trial.steps for trial in totals),
        "mean_return": _mean(totals),
        f"mean_last_{_LAST}": _mean([results.totals(trial.spec.id, _LAST) for trial in trials]),
        "cut_off": sum(trial.cut_off for trial in totals),
        "voids": sum(trial.voids for trial in trials),
        "failed_trials": sum(trial.failure is not None for trial in trials),
        "seconds": seconds,
        "out": str(results.directory),
    }


def _mean(totals: Sequence[Totals]) -> float | None:
    """Return the mean return of all episodes in `totals`; None when there are none."""
    episodes = sum(trial.episodes for trial in totals)
    return sum(trial.sum_of_returns for trial in totals) / episodes if episodes else None
