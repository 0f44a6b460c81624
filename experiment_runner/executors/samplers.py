"""Samplers of configurations: a grid, random values, or Optuna's (extra `tune`).

A sampler is asked for configurations, and told their scores. The same seed and scores give the same
configurations, so that an interrupted search continues when it is repeated from the beginning.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Any, Final, NamedTuple, Protocol

import numpy as np

from experiment_runner.plan.tuning import Range, Space, TunePlan
from glue.errors import ConfigError
from glue.options import Value

Configuration = dict[str, Value]

_AT_ONCE: Final = 4
"""Number of configurations that Optuna proposes at a time, whatever the number of workers."""


class Score(NamedTuple):
    """The result of a configuration: its score, -inf if a trial has failed, and whether it was pruned."""

    value: float
    pruned: bool


class Sampler(Protocol):
    """The choice of configurations."""

    def ask(self, most: int) -> list[Configuration]:
        """Return the next configurations, at most `most`; none at the end."""
        ...

    def tell(self, scores: Sequence[Score]) -> None:
        """Take the scores of the configurations that `ask` returned last, in the same order."""
        ...


def sampler_of(tune: TunePlan, space: Space, seed: int) -> Sampler:
    """Return the sampler of a search.

    Args:
        tune: of the plan.
        space: the values of an agent's options.
        seed: of its random choices, 0 <= seed < 2**63.

    Raises:
        ConfigError: Optuna is not installed.
    """
    if tune.sampler == "grid":
        return _Listed([*_grid(space)])
    if tune.sampler == "random":
        return _Listed(_random(space, tune.configurations, np.random.default_rng(seed)))
    return _Optuna(space, seed)


class _Listed:
    """Configurations that do not depend on scores."""

    def __init__(self, configurations: list[Configuration]) -> None:
        self._left = configurations

    def ask(self, most: int) -> list[Configuration]:
        asked, self._left = self._left[:most], self._left[most:]
        return asked

    def tell(self, scores: Sequence[Score]) -> None:
        pass


def _grid(space: Space) -> Sequence[Configuration]:
    values = [
        list(dict.fromkeys(one.at(i / (one.points - 1)) for i in range(one.points)))
        if isinstance(one, Range)
        else one
        for one in space.values()
    ]
    return [dict(zip(space, chosen, strict=True)) for chosen in itertools.product(*values)]


def _random(space: Space, count: int, generator: np.random.Generator) -> list[Configuration]:
    found = []
    for _ in range(count):
        drawn: Configuration = {}
        for name, one in space.items():
            share = float(generator.random())
            drawn[name] = one.at(share) if isinstance(one, Range) else one[int(share * len(one))]
        if drawn not in found:
            found.append(drawn)
    return found


class _Optuna:
    """Optuna's tree-structured Parzen estimator."""

    def __init__(self, space: Space, seed: int) -> None:
        try:
            import optuna
        except ImportError:
            raise ConfigError("the sampler optuna needs Optuna: pip install 'glue-rl[tune]'") from None
        optuna.logging.set_verbosity(optuna.logging.WARNING)
        self._space = space
        self._study = optuna.create_study(
            direction="maximize", sampler=optuna.samplers.TPESampler(seed=seed % 2**32)
        )
        self._states = optuna.trial.TrialState
        self._asked: list[Any] = []

    def ask(self, most: int) -> list[Configuration]:
        self._asked = [self._study.ask() for _ in range(min(most, _AT_ONCE))]
        return [
            {name: _suggested(trial, name, one) for name, one in self._space.items()} for trial in self._asked
        ]

    def tell(self, scores: Sequence[Score]) -> None:
        for trial, score in zip(self._asked, scores, strict=True):
            if not np.isfinite(score.value):
                self._study.tell(trial, state=self._states.FAIL)
            elif score.pruned:
                trial.report(score.value, 1)
                self._study.tell(trial, state=self._states.PRUNED)
            else:
                self._study.tell(trial, score.value)


def _suggested(trial: Any, name: str, one: Range | tuple[Value, ...]) -> Value:
    value: Value
    if isinstance(one, tuple):
        value = trial.suggest_categorical(name, one)
    elif one.integer:
        value = trial.suggest_int(name, int(one.low), int(one.high), log=one.log)
    else:
        value = trial.suggest_float(name, one.low, one.high, log=one.log)
    return value
