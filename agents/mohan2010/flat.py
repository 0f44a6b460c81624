"""The flat agents, SARSA over the 12 primitive actions: experiments 1 to 3.

As published they never learn from the last reward of an episode, neither from dying nor from
finishing: in Soar the value of the last operator of the top state is updated only when another
operator follows it. That is why they fail in the paper. With `terminal_update` they are the textbook
algorithm, and learn.
Source: Mohan (2010), section 5.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, ClassVar, Final

import numpy as np

from agents import sarsa
from agents.mario import klo, objects, observation
from agents.mario.learner import (
    FULL,
    MALFORMED,
    Discount,
    Epsilon,
    Grid,
    Learning,
    MarioLearner,
    Reduction,
    Seed,
    StepSize,
)
from agents.mohan2010 import features
from agents.policy import epsilon_greedy
from agents.sarsa import Keys, Taken, Values
from glue.compiled.jit import entry, jit
from glue.compiled.records import Array, Flag, Int, new
from glue.options import Option

__all__ = ["ObjectsFlatAgent", "TilesAgent", "TilesCoarseAgent"]

TerminalUpdate = Annotated[
    bool, Option("whether the last reward of an episode is learned (author's agents: lost, as in Soar)")
]

_WHOLE_WINDOW: Final = 0
_WINDOW_PARTS: Final = 1
_OBJECTS: Final = 2


class Mind:
    """What a flat agent keeps from step to step: how it sees, and the last action."""

    senses: Annotated[objects.Senses, objects.Senses]
    representation: Int
    terminal_update: Flag
    scene: Annotated[objects.Scene, objects.Scene]
    last: Annotated[Taken, Taken]
    # room to work in
    states: Annotated[Keys, np.uint64, features.WINDOW]
    values: Annotated[Values, np.float64, klo.KLOS]


@entry
def step(learners: Array, table: Array, minds: Array, body: bytes, reward: float, begins: bool) -> int:
    """Learn from the reward, and return the action to send; FULL or MALFORMED when that cannot be."""
    learner = learners[0]
    mind = minds[0]
    if not sarsa.has_room(learner, table, features.WINDOW):
        return FULL
    if begins:
        _forget(mind)
    if not _perceive(mind, body):
        return MALFORMED
    count = _state(mind)
    sarsa.action_values(table, mind.states, count, mind.values)
    action = epsilon_greedy(learner, mind.values, klo.KLOS)
    sarsa.update(learner, table, mind.last, reward + learner.discount * mind.values[action])
    sarsa.take(mind.last, mind.states, count, action)
    if learner.learning:
        learner.cycles += 1
    return action


@entry
def end(learners: Array, table: Array, minds: Array, reward: float) -> None:
    """Learn from the last reward of an episode, or lose it."""
    mind = minds[0]
    if mind.terminal_update:
        sarsa.update(learners[0], table, mind.last, reward)
    _forget(mind)


@jit
def _forget(mind: Mind) -> None:
    objects.forget_monsters(mind.scene)
    mind.last.count = 0


@jit
def _perceive(mind: Mind, body: bytes) -> bool:
    if mind.representation == _OBJECTS:
        return objects.look(mind.scene, mind.senses, body)
    return observation.read(body, mind.scene.screen)


@jit
def _state(mind: Mind) -> int:
    """Fill in the features of the state; return how many."""
    if mind.representation == _WINDOW_PARTS:
        return features.window_parts(mind.scene.screen, mind.states)
    if mind.representation == _WHOLE_WINDOW:
        mind.states[0] = features.window_whole(mind.scene.screen)
    else:
        mind.states[0] = features.all_objects(mind.scene)
    return 1


class TilesAgent(MarioLearner):
    """Experiment 1, propositional: a state is the 15 tiles around Mario."""

    name = "tiles"
    _step = step
    _end = end
    _representation: ClassVar[int] = _WHOLE_WINDOW

    def __init__(
        self,
        *,
        step_size: StepSize = 0.3,
        discount: Discount = 0.9,
        epsilon: Epsilon = 0.1,
        reduction: Reduction = 0.9999,
        terminal_update: TerminalUpdate = False,
        learning: Learning = True,
        seed: Seed = None,
    ) -> None:
        super().__init__(
            step_size=step_size,
            discount=discount,
            epsilon=epsilon,
            reduction=reduction,
            learning=learning,
            seed=seed,
        )
        self._terminal_update = terminal_update

    def _new_mind(self) -> Array:
        minds = new(Mind)
        minds["representation"] = self._representation
        minds["terminal_update"] = self._terminal_update
        return minds


class TilesCoarseAgent(TilesAgent):
    """Experiment 2, propositional and linear: a value for each of the 15 tiles and its relative speed."""

    name = "tiles-coarse"
    _representation = _WINDOW_PARTS


class ObjectsFlatAgent(TilesAgent):
    """Experiment 3, object-oriented: a state is all objects that are related to Mario."""

    name = "objects-flat"
    _representation = _OBJECTS

    def __init__(
        self,
        *,
        step_size: StepSize = 0.3,
        discount: Discount = 0.9,
        epsilon: Epsilon = 0.1,
        reduction: Reduction = 0.9999,
        grid: Grid = 2,
        terminal_update: TerminalUpdate = False,
        learning: Learning = True,
        seed: Seed = None,
    ) -> None:
        super().__init__(
            step_size=step_size,
            discount=discount,
            epsilon=epsilon,
            reduction=reduction,
            terminal_update=terminal_update,
            learning=learning,
            seed=seed,
        )
        self._grid = grid

    def _settings(self) -> Mapping[str, int | float | str | bool]:
        return {"grid": self._grid}

    def _new_mind(self) -> Array:
        minds = super()._new_mind()
        objects.set_senses(minds["senses"], self._grid, objects.THREATS_2010)
        return minds
