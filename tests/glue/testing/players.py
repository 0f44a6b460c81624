"""Players that keep every rule of the contract."""

from __future__ import annotations

import math
import struct

import numpy as np

from glue.errors import LocalProtocolError
from glue.roles import Agent, Environment
from glue.saves import load_generator, save_generator
from glue.types import Action, Observation

TASK_SPEC = (
    "VERSION RL-Glue-3.0 PROBLEMTYPE episodic DISCOUNTFACTOR 1.0 OBSERVATIONS INTS (0 9) DOUBLES (0 1) "
    "ACTIONS INTS (0 1) REWARDS (-1 0) EXTRA corridor"
)


class Corridor(Environment):
    """Ten fields in a row, from a random one to the last; each observed with a random number."""

    task_spec = TASK_SPEC

    def __init__(self) -> None:
        self.generator = np.random.default_rng(0)
        self.field: int | None = None
        self.starts = 0
        self.ready = False

    def env_seed(self, seed: int) -> None:
        self.generator = np.random.default_rng(seed)

    def env_init(self) -> str:
        self.starts = 0
        self.ready = True
        self.field = None
        return self.task_spec

    def env_start(self) -> Observation:
        self.starts += 1
        self.field = int(self.generator.integers(9))
        return self.observe()

    def env_step(self, action: Action) -> tuple[float, Observation, bool]:
        assert self.field is not None
        self.field = max(0, self.field + (1 if action.ints[0] else -1))
        terminal = self.field == 9
        return float(terminal) - 1, self.observe(), terminal

    def env_cleanup(self) -> None:
        self.ready = False

    def env_message(self, message: str) -> str:
        return f"the corridor heard {message}"

    def env_save(self) -> bytes:
        return save_generator(self.generator)

    def env_load(self, data: bytes) -> None:
        self.generator = load_generator(data)

    def observe(self) -> Observation:
        assert self.field is not None
        return Observation([self.field], [self.generator.random()])


class Wanderer(Agent):
    """Acts at random, more to the right the more it has been rewarded."""

    def __init__(self) -> None:
        self.generator = np.random.default_rng(0)
        self.learned = 0.0
        self.ready = False
        self.acting = False

    def agent_seed(self, seed: int) -> None:
        self.generator = np.random.default_rng(seed)

    def agent_init(self, task_spec: str) -> None:
        self.learned = 0.0
        self.ready = True
        self.acting = False

    def agent_start(self, observation: Observation) -> Action:
        self.acting = True
        return self.act()

    def agent_step(self, reward: float, observation: Observation) -> Action:
        self.learned += 0.01 * reward
        return self.act()

    def agent_end(self, reward: float) -> None:
        self.learned += 0.01 * reward
        self.acting = False

    def agent_cleanup(self) -> None:
        self.ready = False

    def agent_message(self, message: str) -> str:
        return f"the wanderer heard {message}"

    def agent_save(self) -> bytes:
        return struct.pack("<d", self.learned) + save_generator(self.generator)

    def agent_load(self, data: bytes) -> None:
        if len(data) < 8:
            raise LocalProtocolError("a save of the wanderer begins with 8 bytes")
        (self.learned,) = struct.unpack_from("<d", data)
        self.generator = load_generator(data[8:])

    def act(self) -> Action:
        return Action([int(self.generator.random() < math.exp(self.learned))])
