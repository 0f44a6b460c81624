"""The goals that were set for the agents before the full run, and whether they were met.

    glue-paper all
    python -m studies.goals runs/paper --docs docs/paper.md

The goals are for the full study: fewer or shorter trials are not judged.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Final, NamedTuple

import click
import numpy as np

from experiment_runner.report.tables import markdown_table
from experiment_runner.study.paper.experiments import EPISODES, EXPERIMENTS, PAPER_LEVEL, TRIALS, PaperLevel
from experiment_runner.study.paper.outcomes import LevelResults, load
from glue.cli.shared import run
from studies.pages import docs_option, show

BEGIN: Final = "<!-- written by studies.goals, from here -->"
_HEADER: Final = ("required", "found", "met")
_NOT_JUDGED: Final = f"not judged: needs {TRIALS} trials of {EPISODES} episodes"
_MET: Final = {True: "yes", False: "**no**", None: _NOT_JUDGED}

_ORIGINAL_SAMPLE: Final = 130.45
"""The reward of the original sample agent: the mean of ten runs of 500 episodes on the paper's level."""

Number = Callable[[LevelResults], float]


class GoalVerdict(NamedTuple):
    """A goal, the result, and whether the goal is met; None if not judged."""

    required: str
    found: str
    met: bool | None


class _Goal(NamedTuple):
    """A goal for the first of `agents`, on the paper's level seed at a difficulty.

    `check` is called with the outcomes of all `agents`; it returns the result, and whether the goal is met.
    """

    agents: tuple[str, ...]
    required: str
    check: Callable[..., tuple[str, bool]]
    difficulty: int = PAPER_LEVEL.difficulty


def verdicts(outcomes: Sequence[LevelResults]) -> list[GoalVerdict]:
    """Return the verdict on each goal whose agents all have outcomes."""
    known = {(outcome.agent, outcome.level): outcome for outcome in outcomes}
    given = []
    for goal in _GOALS:
        keys = [(agent, PaperLevel(PAPER_LEVEL.seed, goal.difficulty)) for agent in goal.agents]
        if all(key in known for key in keys):
            compared = [known[key] for key in keys]
            found, met = goal.check(*compared)
            judged = all(map(_is_whole, compared))
            given.append(GoalVerdict(f"`{goal.agents[0]}`: {goal.required}", found, met if judged else None))
    return given


def _is_whole(outcome: LevelResults) -> bool:
    trials, episodes = outcome.curves.shape
    return bool(trials >= TRIALS and episodes >= EPISODES)


def _like_the_original(sample: LevelResults) -> tuple[str, bool]:
    return _show(_reward, sample), abs(_reward(sample) - _ORIGINAL_SAMPLE) <= 3


def _less(agent: LevelResults, other: LevelResults) -> tuple[str, bool]:
    return _show(_reward, agent, other), _reward(agent) < _reward(other)


def _more(agent: LevelResults, other: LevelResults) -> tuple[str, bool]:
    return _show(_reward, agent, other), _reward(agent) > _reward(other)


def _no_worse(agent: LevelResults, other: LevelResults) -> tuple[str, bool]:
    return _show(_reward, agent, other), _reward(agent) >= float(other.reward.low)


def _at_least(reward: float) -> Callable[[LevelResults], tuple[str, bool]]:
    return lambda agent: (_show(_reward, agent), _reward(agent) >= reward)


def _at_most(number: Number, limit: float) -> Callable[[LevelResults], tuple[str, bool]]:
    return lambda agent: (_show(number, agent), number(agent) <= limit)


def _least(number: Number) -> Callable[..., tuple[str, bool]]:
    def check(agent: LevelResults, *others: LevelResults) -> tuple[str, bool]:
        return _show(number, agent, *others), number(agent) <= min(map(number, others))

    return check


def _finishing(share: float) -> Callable[[LevelResults], tuple[str, bool]]:
    return lambda agent: (
        f"{agent.trials_finishing} of {len(agent.curves)}",
        agent.trials_finishing >= share * len(agent.curves),
    )


def _reward(outcome: LevelResults) -> float:
    return float(outcome.reward.value)


def _reached(outcome: LevelResults) -> float:
    return math.inf if outcome.reached is None else outcome.reached


def _median_reached(outcome: LevelResults) -> float:
    return float(np.median(outcome.trials_reached)) if outcome.trials_reached else math.inf


def _spread(outcome: LevelResults) -> float:
    return float(np.std(outcome.rewards))


def _show(number: Number, agent: LevelResults, *others: LevelResults) -> str:
    """Return an agent's number, and those it was compared with."""
    form = "{:g}" if number in (_reached, _median_reached) else "{:.2f}"
    shown = form.format(number(agent))
    return f"{shown} against {', '.join(form.format(number(o)) for o in others)}" if others else shown


_SAMPLE: Final = "sample"
_FLAT: Final = tuple(EXPERIMENTS[name].agents for name in "123")
_FOUR, _FIVE, _SIX, _SEVEN = (EXPERIMENTS[name].agents[0].label for name in "4567")
_BEST: Final = "best"

_GOALS: Final = (
    _Goal((_SAMPLE,), f"within 3 of {_ORIGINAL_SAMPLE}, the original's reward", _like_the_original),
    *(
        _Goal((lost.label, _SAMPLE), "fails: less reward than the sample agent", _less)
        for lost, _ in _FLAT
    ),
    *(
        _Goal((textbook.label, lost.label), "learns: more reward than without the terminal update", _more)
        for lost, textbook in _FLAT
    ),
    _Goal((_FOUR,), "reward of 143.5 or more", _at_least(143.5)),
    _Goal((_FIVE,), "reward of 144 or more", _at_least(144)),
    _Goal((_FIVE,), "mean curve reached by episode 1000", _at_most(_reached, 1000)),
    _Goal((_FIVE, _FOUR), f"mean curve reached no later than that of `{_FOUR}`", _least(_reached)),
    _Goal((_FIVE, _FOUR), f"median trial reached no later than that of `{_FOUR}`", _least(_median_reached)),
    _Goal((_SIX,), "reward of 144.5 or more", _at_least(144.5)),
    _Goal((_SIX, _FIVE), f"reward above that of `{_FIVE}`, or in its interval", _no_worse),
    _Goal((_SEVEN,), "reward of 143.5 or more", _at_least(143.5)),
    _Goal((_SEVEN,), "mean curve reached by episode 200", _at_most(_reached, 200)),
    _Goal((_SEVEN, _FOUR, _FIVE, _SIX), "mean curve reached before those of 4, 5 and 6", _least(_reached)),
    _Goal((_SEVEN, _FOUR, _FIVE, _SIX), "median trial reached before theirs", _least(_median_reached)),
    _Goal((_SEVEN, _FOUR, _FIVE, _SIX), "deviation between trials less than theirs", _least(_spread)),
    _Goal((_BEST,), "reward of 150 or more", _at_least(150)),
    _Goal((_BEST,), "every trial finishes", _finishing(1.0)),
    *(
        _Goal((_BEST,), f"8 of 10 trials finish at difficulty {difficulty}", _finishing(0.8), difficulty)
        for difficulty in (1, 2, 3)
    ),
)  # fmt: skip


def as_markdown(given: Sequence[GoalVerdict]) -> str:
    """Return a table in Markdown."""
    rows = [(one.required, one.found, _MET[one.met]) for one in given]
    return f"**Required and found**\n\n{markdown_table(_HEADER, rows, texts=3)}\n"


@click.command("python -m studies.goals")
@click.argument("runs", type=click.Path(path_type=Path, exists=True, file_okay=False))
@docs_option
def goals(runs: Path, docs: Path | None) -> None:
    """Compare the results of the runs of `glue-paper all` with the goals that were set for them."""
    show(BEGIN, as_markdown(verdicts(load(runs))), docs)


if __name__ == "__main__":
    run(goals)
