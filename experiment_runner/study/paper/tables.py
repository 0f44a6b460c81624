"""Tables of our results and the paper's (Mohan 2010): Markdown, plain text for a terminal, and CSV."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Sequence
from typing import Final

import numpy as np

from experiment_runner.report.tables import counted, format_table, markdown_table
from experiment_runner.study.paper.experiments import PAPER_LEVEL
from experiment_runner.study.paper.outcomes import FINISHED, TOLERANCE, WINDOW, LevelResults

_HEADER: Final = (
    "experiment", "agent", "level", "paper", "ours", "95 % interval", "single trials",
    "converged: paper", "reached", "settled", "trials reached", "values", "trials finish", "episodes finish",
)  # fmt: skip
_CYCLES_HEADER: Final = (
    "experiment", "agent", "level", "steps per episode", "decision cycles per episode", "per step",
    "values per trial", "per episode",
)  # fmt: skip
_SHORT_HEADER: Final = ("agent", "level", "paper", "ours", "95 % interval", "trials finish")
_TEXT_COLUMNS: Final = 3  # the first columns; the others are numbers
_LEGEND: Final = f"""\
A *level* is a seed and a difficulty. *Ours* is the mean over trials of the mean return of the last
{WINDOW} episodes, with its 95 % bootstrap interval; *single trials* are the lowest and the highest trial.
The running mean of {WINDOW} episodes, over all trials, has *reached* its final value when it is first at
most {TOLERANCE:g} below it, and has *settled* when from then on it stays within {TOLERANCE:g} of it.
*Trials reached* is the median of the episodes at which the single trials reached their final values.
*Values* is the mean number of values that a trial has learned at its end. A trial *finishes* when at
least half of its last {WINDOW} episodes reach the goal, that is, return {FINISHED:g} or more."""


def as_markdown(outcomes: Sequence[LevelResults]) -> str:
    """Return tables in Markdown: the paper's level, its higher difficulties, other seeds."""
    seed = PAPER_LEVEL.seed
    groups = {
        f"The paper's level: seed {seed}, difficulty {PAPER_LEVEL.difficulty}": [
            outcome for outcome in outcomes if outcome.level == PAPER_LEVEL
        ],
        f"Seed {seed}, higher difficulties": [
            outcome for outcome in outcomes if outcome.level.seed == seed and outcome.level != PAPER_LEVEL
        ],
        "Other level seeds": [outcome for outcome in outcomes if outcome.level.seed != seed],
    }
    tables = [
        f"**{title}**\n\n{_table(_HEADER, map(_cells, group))}" for title, group in groups.items() if group
    ]
    return "\n\n".join([_LEGEND, *tables, _effort(outcomes)]) + "\n"


def as_soar_markdown(outcomes: Sequence[LevelResults]) -> str:
    """Return tables in Markdown about the agents on the Soar kernel and ours: results, cycles."""
    counts = []
    for outcome in outcomes:
        if not outcome.cycles:
            continue
        per_episode, steps = float(np.mean(outcome.cycles)), outcome.steps / outcome.episodes
        values = float(np.mean(outcome.values))
        counts.append(
            (
                *_cells(outcome)[:_TEXT_COLUMNS],
                f"{steps:,.0f}",
                f"{per_episode:,.0f}",
                f"{per_episode / steps:.2f}",
                f"{values:,.0f}",
                f"{values / outcome.curves.shape[1]:.1f}",
            )
        )
    tables = [f"**Rewards**\n\n{_table(_HEADER, map(_cells, outcomes))}"]
    if counts:
        tables.append(f"**Decision cycles, and values learned**\n\n{_table(_CYCLES_HEADER, counts)}")
    return "\n\n".join([*tables, _effort(outcomes)]) + "\n"


def as_text(outcomes: Sequence[LevelResults], width: int | None = None) -> str:
    """Return a table for a terminal: the paper's rewards and ours, and how many trials finish.

    Args:
        outcomes: a row for each.
        width: see `format_table`.
    """
    rows = []
    for outcome in outcomes:
        cells = dict(zip(_HEADER, _cells(outcome), strict=True))
        name = f"{outcome.experiment.name} {cells['agent'].replace('`', '')}"
        rows.append((name, *(cells[column] for column in _SHORT_HEADER[1:])))
    return f"{format_table(_SHORT_HEADER, rows, width=width)}\n\n{_effort(outcomes)}\n"


def as_csv(outcomes: Sequence[LevelResults]) -> str:
    """Return a header and a row for each agent and level; a number that is not available is empty."""
    text = io.StringIO()
    records = [_record(outcome) for outcome in outcomes]
    writer = csv.DictWriter(text, records[0] if records else (), lineterminator="\n")
    writer.writeheader()
    writer.writerows(records)
    return text.getvalue()


def _table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    return markdown_table(header, [*rows], _TEXT_COLUMNS)


def _cells(outcome: LevelResults) -> tuple[str, ...]:
    paper, reward, reached = outcome.published, outcome.reward, outcome.trials_reached
    experiment, count = outcome.experiment, len(outcome.curves)
    return (
        f"{experiment.name}, {experiment.title}",
        f"`{outcome.agent}`" + (f" ({count} of {outcome.planned} trials)" if count < outcome.planned else ""),
        f"{outcome.level.seed}, {outcome.level.difficulty}",
        f"{paper.reward:.2f}" if paper and paper.reward is not None else "",
        f"{reward.value:.2f}",
        "" if np.isnan(reward.low) else f"{reward.low:.2f} to {reward.high:.2f}",
        f"{outcome.rewards.min():.1f} to {outcome.rewards.max():.1f}",
        paper.convergence if paper else "",
        f"{outcome.reached or ''}",
        f"{outcome.settled or 'never'}",
        f"{np.median(reached):.0f}" if reached else "",
        f"{np.mean(outcome.values):,.0f}" if outcome.values else "",
        f"{outcome.trials_finishing} of {count}",
        f"{outcome.finishing.mean():.0%}",
    )


def _record(outcome: LevelResults) -> dict[str, object]:
    paper, reward = outcome.published, outcome.reward
    reached, settled = outcome.trials_reached, outcome.trials_settled
    return {
        "experiment": outcome.experiment.name,
        "agent": outcome.agent,
        "level_seed": outcome.level.seed,
        "level_difficulty": outcome.level.difficulty,
        "trials": len(outcome.curves),
        "episodes": outcome.curves.shape[1],
        "paper_reward": paper.reward if paper else None,
        "reward": float(reward.value),
        "reward_low": None if np.isnan(reward.low) else float(reward.low),
        "reward_high": None if np.isnan(reward.high) else float(reward.high),
        "reward_lowest": float(outcome.rewards.min()),
        "reward_highest": float(outcome.rewards.max()),
        "paper_converged": paper.convergence if paper else None,
        "reached": outcome.reached,
        "settled": outcome.settled,
        "trials_reached_median": float(np.median(reached)) if reached else None,
        "trials_settled": len(settled),
        "trials_settled_median": float(np.median(settled)) if settled else None,
        "values": float(np.mean(outcome.values)) if outcome.values else None,
        "trials_finishing": outcome.trials_finishing,
        "episodes_finishing": float(outcome.finishing.mean()),
        "steps": outcome.steps,
        "seconds": outcome.seconds,
    }


def _effort(outcomes: Sequence[LevelResults]) -> str:
    trials = sum(len(outcome.curves) for outcome in outcomes)
    steps = sum(outcome.steps for outcome in outcomes)
    hours = sum(outcome.seconds for outcome in outcomes) / 3600
    return f"{counted(trials, 'trial')}, {steps / 1e6:,.0f} million steps, {hours:.1f} hours of one core."
