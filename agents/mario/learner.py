"""What the learning agents of Mohan (2010) have in common: hyperparameters, seed, saving, loading.

An agent is two kernels, one for a step and one for the end of an episode, and three arrays that they
work on: the learner (hyperparameters, generator, counters), its table of values, and a mind, the
working memory of one episode. What outlives an episode is in the first two.
"""

from __future__ import annotations

import abc
from collections.abc import Callable, Mapping
from typing import Annotated, ClassVar, Final

import numpy as np

from agents.checkpoint import Checkpoint, CheckpointError, pack, unpack
from agents.mario.klo import ACTIONS
from agents.mario.observation import CHARS, malformed
from agents.policy import seeded
from agents.sarsa import Learner, contents, grown, table_of
from glue.compiled.jit import announce_compilation
from glue.compiled.records import Array, new
from glue.errors import ConfigError, TaskSpecError
from glue.options import Option
from glue.taskspec import MARIO, parse_task_spec
from glue.types import Action, Observation

__all__ = [
    "FULL", "MALFORMED", "Discount", "Epsilon", "Learning", "MarioLearner", "Reduction", "StepSize",
    "require_mario",
]  # fmt: skip

FULL: Final = -1
"""What a step returns, having done nothing, when the table must grow first."""
MALFORMED: Final = -2
"""What a step returns for an observation whose layout is not Mario's."""

StepSize = Annotated[float, Option("step size of SARSA (Mohan 2010: 0.3)", low=0, high=1)]
Discount = Annotated[float, Option("discount of SARSA (Mohan 2010: 0.9)", low=0, high=1)]
Epsilon = Annotated[float, Option("chance to explore, at first (Mohan 2010: 0.1)", low=0, high=1)]
Reduction = Annotated[
    float, Option("what every decision cycle multiplies epsilon by (Mohan 2010: 0.9999)", low=0, high=1)
]
Grid = Annotated[
    int, Option("cells per tile of the distances to monsters (author's agents: 2)", low=1, high=16)
]
Seed = Annotated[int | None, Option("seed of its random choices; the experiment's if not given", low=0)]
Learning = Annotated[bool, Option("whether to learn; off: the values and epsilon stay as they are")]

Step = Callable[[Array, Array, Array, bytes, float, bool], int]
End = Callable[[Array, Array, Array, float], None]


def require_mario(task_spec: str, agent: str) -> None:
    """Do nothing if a task spec is that of Infinite Mario.

    Raises:
        ConfigError: it is another; the message names the agent and the remedy.
    """
    try:
        version = parse_task_spec(task_spec).version
    except TaskSpecError:
        version = ""
    if version != MARIO:
        raise ConfigError(
            f"agent {agent} plays Infinite Mario alone, whose task spec begins VERSION {MARIO}; "
            f"it was given {task_spec!r:.80}: use it with the environment mario"
        )


class MarioLearner(abc.ABC):
    """An agent that plays Infinite Mario and learns a table of values by SARSA."""

    name: ClassVar[str]
    _step: ClassVar[Step]
    _end: ClassVar[End]

    def __init__(
        self,
        *,
        step_size: float,
        discount: float,
        epsilon: float,
        reduction: float,
        learning: bool,
        seed: int | None,
    ) -> None:
        self._hyperparameters = {
            "step_size": step_size,
            "discount": discount,
            "epsilon": epsilon,
            "reduction": reduction,
            "learning": learning,
        }
        self._own_seed = seed
        self._seed = seed or 0
        self._forget()

    @abc.abstractmethod
    def _new_mind(self) -> Array:
        """Return the working memory of this agent, before its first episode."""

    def _settings(self) -> Mapping[str, int | float | str | bool]:
        """Return the options that the keys of the values depend on."""
        return {}

    def agent_seed(self, seed: int) -> None:
        """Seed every random choice after the next init, unless the option `seed` was given."""
        if self._own_seed is None:
            self._seed = seed

    def agent_init(self, task_spec: str) -> None:
        """Forget everything.

        Raises:
            ConfigError: the task is not Infinite Mario.
        """
        require_mario(task_spec, self.name)
        self._warm_up()
        self._forget()
        self._mind = self._new_mind()

    def agent_start(self, observation: Observation) -> Action:
        """Begin an episode; one that was cut off teaches nothing more."""
        return self._act(0.0, observation, True)

    def agent_step(self, reward: float, observation: Observation) -> Action:
        """Learn from the reward and choose the next action."""
        return self._act(reward, observation, False)

    def agent_end(self, reward: float) -> None:
        """Learn from the last reward."""
        type(self)._end(self._learner, self._table, self._mind, float(reward))

    def agent_cleanup(self) -> None:  # noqa: B027  # not a duty of subclasses
        """Do nothing: what was learned stays until the next init."""

    def agent_message(self, message: str) -> str:
        """Answer `values`, the number of values learned, and `epsilon`, the present chance to explore."""
        if message == "values":
            return str(self._learner["entries"][0])
        if message == "epsilon":
            learner = self._learner[0]
            return repr(float(learner["epsilon"] * learner["reduction"] ** float(learner["cycles"])))
        return f"agent {self.name} answers the messages values and epsilon only"

    def agent_save(self) -> bytes:
        """Return the values, the generator's state and the counters."""
        keys, values = contents(self._table)
        numbers = {name: int(self._learner[name][0]) for name in ("random", "cycles")}
        return pack(Checkpoint(self.name, self._settings(), numbers, {"keys": keys, "values": values}))

    def agent_load(self, data: bytes) -> None:
        """Continue from what `agent_save` returned; the hyperparameters stay this agent's own.

        Raises:
            CheckpointError: it is damaged, or of another agent, or of options that change the keys.
        """
        saved = unpack(data, self.name, self._settings())
        keys, values = saved.arrays.get("keys"), saved.arrays.get("values")
        if keys is None or values is None or keys.dtype != np.uint64 or values.dtype != np.float64:
            raise CheckpointError("this saved agent lacks its keys or its values")
        if len(keys) != len(values) or not np.all(keys[:-1] < keys[1:]) or not np.all(keys > 0):
            raise CheckpointError("the keys of this saved agent must ascend, with one value for each")
        if not np.all(np.isfinite(values)):
            raise CheckpointError("the values of this saved agent must be finite")
        random, cycles = saved.numbers.get("random", -1), saved.numbers.get("cycles", -1)
        if not (0 <= random < 2**64 and 0 <= cycles < 2**63):
            raise CheckpointError("this saved agent lacks its generator's state or its count of cycles")
        self._learner["random"] = random
        self._learner["cycles"] = cycles
        self._learner["entries"] = len(keys)
        self._table = table_of(keys, values)

    def _warm_up(self) -> None:
        """Have the kernels compiled or read from disk, so that no step of an episode waits for that."""
        nothing = Observation([0] * 3, [0.0] * 4, bytes(CHARS))
        self._mind = self._new_mind()
        with announce_compilation(f"the agent {self.name}"):
            self.agent_start(nothing)
            self.agent_end(0.0)

    def _forget(self) -> None:
        self._learner = new(Learner)
        for name, value in self._hyperparameters.items():
            self._learner[name] = value
        self._learner["random"] = seeded(self._seed)
        self._table = table_of(np.empty(0, np.uint64), np.empty(0, np.float64))

    def _act(self, reward: float, observation: Observation, begins: bool) -> Action:
        body = observation.body
        chosen = type(self)._step(self._learner, self._table, self._mind, body, float(reward), begins)
        while chosen == FULL:
            self._table = grown(self._table)
            chosen = type(self)._step(self._learner, self._table, self._mind, body, float(reward), begins)
        if chosen == MALFORMED:
            raise malformed(observation)
        return ACTIONS[chosen]
