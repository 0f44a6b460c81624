"""Agents that do not learn: RL-Glue's skeleton, and one that acts at random in any task."""

from __future__ import annotations

from typing import Annotated, ClassVar

import numpy as np

from glue.errors import LocalProtocolError
from glue.options import Option
from glue.roles import Agent
from glue.saves import pack_generator, unpack_generator
from glue.taskspec import Space, legal_values, mask_sizes, parse_task_spec
from glue.taskspec.draws import Draws
from glue.types import Action, Observation


class RandomAgent(Agent):
    """Acts at random, evenly among the legal actions of the task spec and of a mask; it learns nothing."""

    name: ClassVar[str] = "random"
    agent_masks = True

    def __init__(
        self,
        *,
        seed: Annotated[int | None, Option("random seed; the experiment's if not given", low=0)] = None,
    ) -> None:
        self._own_seed = seed
        self._space = Space(stated=False)
        self._sizes: tuple[int, ...] = ()  # of each int of an action, in a task with masks
        self._lows: list[int] = []
        self._draws = Draws(self._space, np.random.default_rng(seed or 0))

    def agent_seed(self, seed: int) -> None:
        generator = np.random.default_rng(seed if self._own_seed is None else self._own_seed)
        self._draws = Draws(self._space, generator)

    def agent_init(self, task_spec: str) -> None:
        spec = parse_task_spec(task_spec)
        actions = spec.actions
        if not actions.stated:
            raise LocalProtocolError(
                f"agent {self.name} needs a task spec that states the actions, not {task_spec!r:.80}"
            )
        self._space = actions
        self._sizes = mask_sizes(actions) if spec.masks else ()
        self._lows = [int(range_.ends[0]) for range_ in actions.ints] if spec.masks else []
        self._draws = Draws(actions, self._draws.settle())

    def agent_start(self, observation: Observation) -> Action:
        return self._act(observation)

    def agent_step(self, reward: float, observation: Observation) -> Action:
        return self._act(observation)

    def agent_message(self, message: str) -> str:
        return f"agent {self.name} answers no messages"

    def agent_save(self) -> bytes:
        return pack_generator(self.name, self._draws.settle())

    def agent_load(self, data: bytes) -> None:
        self._draws = Draws(self._space, unpack_generator(data, self.name))

    def _act(self, observation: Observation) -> Action:
        if not observation.packed_mask:
            return Action._wrap(self._draws.draw())  # drawn within the bounds: no check is needed
        generator = self._draws.settle()
        doubles, chars = self._space.sample(generator)[1:] if any(self._space.counts[1:]) else ((), b"")
        ints = []
        for low, legal in zip(self._lows, legal_values(observation, self._sizes), strict=True):
            choices = np.flatnonzero(legal)
            ints.append(low + int(choices[generator.integers(len(choices))]))
        return Action(ints, doubles, chars)


class SkeletonAgent(RandomAgent):
    """Acts at random, and knows its name. Source: RL-Glue 3.0, skeleton example."""

    name = "skeleton"

    def agent_message(self, message: str) -> str:
        if message == "what is your name?":
            return "my name is skeleton_agent!"
        return "I don't know how to respond to your message"
