"""The flat agents, SARSA over the 12 primitive actions: experiments 1 to 3.

As published they never learn from the last reward of an episode, neither from dying nor from
finishing: in Soar the value of the last operator of the top state is updated only when another
operator follows it. That is why they fail in the paper. With `terminal_update` they are the textbook
algorithm, and learn.
Source: Mohan (2010), section 5.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, ClassVar, Final

import numpy as np

from agents import sarsa
from agents.mario import observation
from agents.mario.agent import NUM_ACTIONS
from agents.mario.objects import THREATS_2010, Scene, Senses, forget_monsters, look, set_senses
from agents.mohan2010 import features
from agents.mohan2010.learner import FULL, MALFORMED, LearnerOptions, MarioLearner, ObjectOptions
from agents.sarsa import Keys, Taken, Values, epsilon_greedy
from glue.compiled.jit import entry, jit
from glue.compiled.records import Array, Flag, Int, new
from glue.options import Option
from glue.saves import Setting

_TerminalUpdate = Annotated[
    bool, Option("whether to learn the last reward of an episode (author's agents: lost, as in Soar)")
]

_WHOLE_WINDOW: Final = 0
_WINDOW_PARTS: Final = 1
_OBJECTS: Final = 2


class Memory:
    """The working memory of a flat agent: its perception, and the last action."""

    senses: Annotated[Senses, Senses]
    representation: Int
    terminal_update: Flag
    scene: Annotated[Scene, Scene]
    last: Annotated[Taken, Taken]
    # scratch space
    states: Annotated[Keys, np.uint64, features.WINDOW]
    values: Annotated[Values, np.float64, NUM_ACTIONS]


@entry
def step(learners: Array, table: Array, memories: Array, body: bytes, reward: float, begins: bool) -> int:
    """Learn from the reward, and return the action to send; or FULL or MALFORMED."""
    learner = learners[0]
    memory = memories[0]
    if not sarsa.has_room(learner, table, features.WINDOW):
        return FULL
    if begins:
        _forget(memory)
    if not _perceive(memory, body):
        return MALFORMED
    count = _state(memory)
    sarsa.action_values(table, memory.states, count, memory.values)
    action = epsilon_greedy(learner, memory.values, NUM_ACTIONS)
    sarsa.update(learner, table, memory.last, reward + learner.discount * memory.values[action])
    sarsa.take(memory.last, memory.states, count, action)
    if learner.learning:
        learner.cycles += 1
    return action


@entry
def end(learners: Array, table: Array, memories: Array, reward: float) -> None:
    """Learn from the last reward of an episode, or ignore it."""
    memory = memories[0]
    if memory.terminal_update:
        sarsa.update(learners[0], table, memory.last, reward)
    _forget(memory)


@jit
def _forget(memory: Memory) -> None:
    forget_monsters(memory.scene)
    memory.last.count = 0


@jit
def _perceive(memory: Memory, body: bytes) -> bool:
    if memory.representation == _OBJECTS:
        return look(memory.scene, memory.senses, body)
    return observation.read(body, memory.scene.screen)


@jit
def _state(memory: Memory) -> int:
    """Fill in the features of the state; return how many."""
    if memory.representation == _WINDOW_PARTS:
        return features.window_parts(memory.scene.screen, memory.states)
    if memory.representation == _WHOLE_WINDOW:
        memory.states[0] = features.window_whole(memory.scene.screen)
    else:
        memory.states[0] = features.all_objects(memory.scene)
    return 1


class TilesAgent(MarioLearner):
    """Experiment 1, propositional: a state is the 15 tiles around Mario."""

    @dataclass(frozen=True, kw_only=True)
    class Options(LearnerOptions):
        terminal_update: _TerminalUpdate = False

    _options: Options

    name = "tiles"
    _step = step
    _end = end
    _representation: ClassVar[int] = _WHOLE_WINDOW

    def _new_memory(self) -> Array:
        memories = new(Memory)
        memories["representation"] = self._representation
        memories["terminal_update"] = self._options.terminal_update
        return memories


class TilesCoarseAgent(TilesAgent):
    """Experiment 2, propositional and linear: a value for each of the 15 tiles and its relative speed."""

    name = "tiles-coarse"
    _representation = _WINDOW_PARTS


class ObjectsFlatAgent(TilesAgent):
    """Experiment 3, object-oriented: a state is all objects that are related to Mario."""

    @dataclass(frozen=True, kw_only=True)
    class Options(ObjectOptions, TilesAgent.Options):
        pass

    _options: Options

    name = "objects-flat"
    _representation = _OBJECTS

    def _settings(self) -> Mapping[str, Setting]:
        return {"grid": self._options.grid}

    def _new_memory(self) -> Array:
        memories = super()._new_memory()
        set_senses(memories["senses"], self._options.grid, THREATS_2010)
        return memories
