"""What an experiment came to, at its end: a table for people, numbers for a script."""

from __future__ import annotations

from typing import Final

from experiment_runner.store import Results
from experiment_runner.tables import format_table

__all__ = ["summarize", "tabulate"]

_LAST: Final = 100
_COLUMNS: Final = ("trial", "episodes", "steps", "mean return", f"mean of last {_LAST}", "cut off", "void")


def tabulate(results: Results, seconds: float) -> str:
    """Return a line for each trial, and why it failed if it did."""
    rows, failures = [], []
    for record in results.trials():
        episodes = results.episodes(record.spec.id)
        returns = results.returns(record.spec.id)
        rows.append(
            (
                record.spec.id,
                f"{record.done}/{record.spec.episodes}",
                f"{sum(episode.steps for episode in episodes):,}",
                f"{returns.mean():.2f}" if returns.size else "-",
                f"{returns[-_LAST:].mean():.2f}" if returns.size else "-",
                f"{sum(not episode.terminal for episode in episodes)}",
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
    episodes = [episode for trial in trials for episode in results.episodes(trial.spec.id)]
    returns = [episode.episode_return for episode in episodes]
    last = [value for trial in trials for value in results.returns(trial.spec.id)[-_LAST:].tolist()]
    return {
        "summary": True,
        "episodes": len(episodes),
        "steps": sum(episode.steps for episode in episodes),
        "mean_return": sum(returns) / len(returns) if returns else None,
        f"mean_last_{_LAST}": sum(last) / len(last) if last else None,
        "cut_off": sum(not episode.terminal for episode in episodes),
        "voids": sum(trial.voids for trial in trials),
        "failed_trials": sum(trial.failure is not None for trial in trials),
        "seconds": seconds,
        "out": str(results.directory),
    }
