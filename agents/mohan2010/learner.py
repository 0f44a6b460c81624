"""Base class of the learning agents of Mohan (2010): hyperparameters, learning, saving, loading.

An agent is two compiled functions, one for a step and one for the end of an episode, and three arrays
that they work on: the learner (hyperparameters, generator, counters), its table of values, and its
working memory of one episode. The first two outlive an episode.
"""

from __future__ import annotations

import abc
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Final

import numpy as np

from agents.mario.agent import ACTIONS, MarioAgent, SarsaOptions
from agents.mario.observation import CHARS, malformed
from agents.sarsa import Learner, contents, grown, seeded, table_of
from glue.compiled.jit import announce_compilation
from glue.compiled.records import Array, new
from glue.errors import SaveError
from glue.options import Option
from glue.saves import Saved, Setting, pack, unpack
from glue.types import Action, Observation

FULL: Final = -1
"""Result of a step that did nothing, since the table must grow first."""
MALFORMED: Final = -2
"""Result of a step for an observation whose layout is not Mario's."""


@dataclass(frozen=True, kw_only=True)
class LearnerOptions(SarsaOptions):
    """The hyper-parameters of every agent of the paper."""

    learning: Annotated[bool, Option("whether to learn; off: the values and epsilon stay as they are")] = True


@dataclass(frozen=True, kw_only=True)
class ObjectOptions(LearnerOptions):
    """The hyper-parameters of agents that see objects."""

    grid: Annotated[
        int, Option("cells per tile of the distances to monsters (author's agents: 2)", low=1, high=16)
    ] = 2


StepFunction = Callable[[Array, Array, Array, bytes, float, bool], int]
EndFunction = Callable[[Array, Array, Array, float], None]


class MarioLearner(MarioAgent):
    """An agent that plays Infinite Mario and learns a table of values by SARSA."""

    _step: ClassVar[StepFunction]
    _end: ClassVar[EndFunction]

    Options: ClassVar[type[LearnerOptions]] = LearnerOptions
    _options: LearnerOptions

    def __init__(self, **options: Any) -> None:
        self._options = self.Options(**options)
        super().__init__(self._options.seed)
        self._clear()

    @abc.abstractmethod
    def _new_memory(self) -> Array:
        """Return the working memory of this agent, before its first episode."""

    def _settings(self) -> Mapping[str, Setting]:
        """Return the options that the keys of the values depend on."""
        return {}

    def agent_start(self, observation: Observation) -> Action:
        """Begin an episode; nothing more is learned from a truncated one (cut off)."""
        self._learner["errors"] = self._learner["updates"] = 0
        return self._act(0.0, observation, True)

    def agent_step(self, reward: float, observation: Observation) -> Action:
        """Learn from the reward and choose the next action."""
        return self._act(reward, observation, False)

    def agent_end(self, reward: float) -> None:
        """Learn from the last reward."""
        type(self)._end(self._learner, self._table, self._memory, float(reward))

    def agent_message(self, message: str) -> str:
        """Answer `values` and `cycles`, the number of each, and `epsilon`, the current chance to explore."""
        if message == "values":
            return str(self._learner["entries"][0])
        if message == "cycles":
            return str(self._learner["cycles"][0])
        if message == "epsilon":
            return repr(self._epsilon())
        return f"agent {self.name} answers only the messages values, cycles and epsilon"

    def agent_metrics(self) -> dict[str, float]:
        """Return step size, epsilon, the size of the table, and the mean absolute TD error of the episode."""
        learner = self._learner[0]
        return {
            "step size": float(learner["step_size"]),
            "epsilon": self._epsilon(),
            "mean TD error": float(learner["errors"]) / max(int(learner["updates"]), 1),
            "table size": float(learner["entries"]),
        }

    def _epsilon(self) -> float:
        learner = self._learner[0]
        return float(learner["epsilon"] * learner["reduction"] ** float(learner["cycles"]))

    def agent_save(self) -> bytes:
        """Return the values, the generator's state and the counters."""
        keys, values = contents(self._table)
        numbers = {name: int(self._learner[name][0]) for name in ("random", "cycles")}
        return pack(Saved(self.name, self._settings(), numbers, {"keys": keys, "values": values}))

    def agent_load(self, data: bytes) -> None:
        """Continue from a state that `agent_save` returned; this agent keeps its own hyperparameters.

        Raises:
            SaveError: `data` is damaged, or of another agent, or of options that change the keys.
        """
        saved = unpack(data, self.name, self._settings())
        keys, values = saved.array("keys", np.uint64, low=1), saved.array("values", np.float64)
        if len(keys) != len(values) or not np.all(keys[:-1] < keys[1:]):
            raise SaveError(f"saved {self.name}: its keys must ascend, with one value for each")
        random, cycles = saved.number("random", high=2**64 - 1), saved.number("cycles")
        self._table = table_of(keys, values)
        self._learner["random"] = random
        self._learner["cycles"] = cycles
        self._learner["entries"] = len(keys)

    def _reset(self) -> None:
        self._warm_up()
        self._clear()
        self._memory = self._new_memory()

    def _warm_up(self) -> None:
        """Compile the two functions or load them from disk, so that no step of an episode has to wait."""
        nothing = Observation([0] * 3, [0.0] * 4, bytes(CHARS))
        self._memory = self._new_memory()
        with announce_compilation(f"the agent {self.name}"):
            self.agent_start(nothing)
            self.agent_end(0.0)

    def _clear(self) -> None:
        self._learner = new(Learner)
        for name in ("step_size", "discount", "epsilon", "reduction", "learning"):
            self._learner[name] = getattr(self._options, name)
        self._learner["random"] = seeded(self._seed)
        self._table = table_of(np.empty(0, np.uint64), np.empty(0, np.float64))

    def _act(self, reward: float, observation: Observation, begins: bool) -> Action:
        body = observation.body
        chosen = type(self)._step(self._learner, self._table, self._memory, body, float(reward), begins)
        while chosen == FULL:
            self._table = grown(self._table)
            chosen = type(self)._step(self._learner, self._table, self._memory, body, float(reward), begins)
        if chosen == MALFORMED:
            raise malformed(observation)
        return ACTIONS[chosen]
