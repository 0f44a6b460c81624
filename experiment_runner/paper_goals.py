"""What was required of the agents before the full run, and what was found."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Final, NamedTuple

import numpy as np

from experiment_runner.paper import EXPERIMENTS, PAPER_LEVEL, Level
from experiment_runner.paper_outcomes import Outcome

__all__ = ["Verdict", "verdicts"]

_ORIGINAL_SAMPLE: Final = 130.45
"""The reward of the competition's sample agent itself: ten runs of 500 episodes on the paper's level."""


class Verdict(NamedTuple):
    """Something that was required, what was found, and whether that is enough."""

    required: str
    found: str
    met: bool


class _Goal(NamedTuple):
    """What is required of the first of `agents`, on the paper's seed at a difficulty.

    `check` is called with the outcome of each; it returns what was found, and whether that is enough.
    """

    agents: tuple[str, ...]
    required: str
    check: Callable[..., tuple[str, bool]]
    difficulty: int = PAPER_LEVEL.difficulty


def verdicts(outcomes: Sequence[Outcome]) -> list[Verdict]:
    """Return a verdict on every goal whose agents have played."""
    known = {(outcome.agent, outcome.level): outcome for outcome in outcomes}
    given = []
    for goal in _GOALS:
        keys = [(agent, Level(PAPER_LEVEL.seed, goal.difficulty)) for agent in goal.agents]
        if all(key in known for key in keys):
            found, met = goal.check(*(known[key] for key in keys))
            given.append(Verdict(f"`{goal.agents[0]}`: {goal.required}", found, met))
    return given


def _like_the_original(sample: Outcome) -> tuple[str, bool]:
    return _show(_reward, sample), abs(_reward(sample) - _ORIGINAL_SAMPLE) <= 3


def _less(agent: Outcome, other: Outcome) -> tuple[str, bool]:
    return _show(_reward, agent, other), _reward(agent) < _reward(other)


def _more(agent: Outcome, other: Outcome) -> tuple[str, bool]:
    return _show(_reward, agent, other), _reward(agent) > _reward(other)


def _no_worse(agent: Outcome, other: Outcome) -> tuple[str, bool]:
    return _show(_reward, agent, other), _reward(agent) >= float(other.reward.low)


def _at_least(reward: float) -> Callable[[Outcome], tuple[str, bool]]:
    return lambda agent: (_show(_reward, agent), _reward(agent) >= reward)


def _reached_by(episode: int) -> Callable[[Outcome], tuple[str, bool]]:
    return lambda agent: (_show(_reached, agent), _reached(agent) <= episode)


def _no_later(agent: Outcome, *others: Outcome) -> tuple[str, bool]:
    return _show(_reached, agent, *others), _reached(agent) <= min(map(_reached, others))


def _least_spread(agent: Outcome, *others: Outcome) -> tuple[str, bool]:
    return _show(_spread, agent, *others), _spread(agent) < min(map(_spread, others))


def _finishing(share: float) -> Callable[[Outcome], tuple[str, bool]]:
    return lambda agent: (
        f"{agent.trials_finishing} of {len(agent.curves)}",
        agent.trials_finishing >= share * len(agent.curves),
    )


def _reward(outcome: Outcome) -> float:
    return float(outcome.reward.value)


def _reached(outcome: Outcome) -> float:
    return math.inf if outcome.reached is None else outcome.reached


def _spread(outcome: Outcome) -> float:
    return float(np.std(outcome.rewards))


def _show(number: Callable[[Outcome], float], agent: Outcome, *others: Outcome) -> str:
    """Return an agent's number, and against whose it was held."""
    form = "{:g}" if number is _reached else "{:.2f}"
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
        _Goal((textbook.label, lost.label), "learns: more reward than where the terminal one is lost", _more)
        for lost, textbook in _FLAT
    ),
    _Goal((_FOUR,), "reward of 143.5 or more", _at_least(143.5)),
    _Goal((_FIVE,), "reward of 144 or more", _at_least(144)),
    _Goal((_FIVE,), "reached by episode 1000", _reached_by(1000)),
    _Goal((_FIVE, _FOUR), f"reached no later than `{_FOUR}`", _no_later),
    _Goal((_SIX,), "reward of 144.5 or more", _at_least(144.5)),
    _Goal((_SIX, _FIVE), f"reward above that of `{_FIVE}`, or in its interval", _no_worse),
    _Goal((_SEVEN,), "reward of 143.5 or more", _at_least(143.5)),
    _Goal((_SEVEN,), "reached by episode 200", _reached_by(200)),
    _Goal((_SEVEN, _FOUR, _FIVE, _SIX), "reached no later than any of experiments 4 to 6", _no_later),
    _Goal((_SEVEN, _FOUR, _FIVE, _SIX), "less deviation between trials than any of these", _least_spread),
    _Goal((_BEST,), "reward of 150 or more", _at_least(150)),
    _Goal((_BEST,), "every trial finishes", _finishing(1.0)),
    *(
        _Goal((_BEST,), f"8 of 10 trials finish at difficulty {difficulty}", _finishing(0.8), difficulty)
        for difficulty in (1, 2, 3)
    ),
)  # fmt: skip
