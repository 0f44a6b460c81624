"""The agent that plays only by a network, in NumPy, from the current observation.

`studies/ppo.py` and `studies/imitation.py` in the repository write its files.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, ClassVar, Final

import numpy as np

from agents.mario.actions import ACTIONS, NUM_ACTIONS
from agents.mario.agent import MarioAgent
from agents.mario.views import tiles_and_sprites
from agents.network.features import NONE, RECENT, features, remember
from agents.network.weights import load, preferences
from glue.options import Option
from glue.saves import pack_generator, unpack_generator
from glue.types import Action, Observation

_SHIPPED: Final = str(Path(__file__).with_name("policy.npz"))


class NetworkAgent(MarioAgent):
    """A trained network: each action is drawn from the softmax of its preferences.

    Args:
        policy: the file of the network; by default the installed one, whose training docs/generalisation.md
            describes.
        greedy: whether to take the preferred action instead.

    Raises:
        ConfigError: the file is missing, or holds no such network.
    """

    name: ClassVar[str] = "network"

    def __init__(
        self,
        *,
        policy: Annotated[str, Option("file of the network, instead of the one that is installed")] = "",
        greedy: Annotated[bool, Option("take the preferred action, instead of drawing one")] = False,
    ) -> None:
        super().__init__(None)
        self._network = load(policy or _SHIPPED)
        self._greedy = greedy
        self._reset()

    def _reset(self) -> None:
        self._recent = np.full((1, RECENT), NONE, np.int64)
        self._generator = np.random.default_rng(self._seed)

    def agent_start(self, observation: Observation) -> Action:
        self._recent[:] = NONE
        return self._act(observation)

    def agent_step(self, reward: float, observation: Observation) -> Action:
        return self._act(observation)

    def agent_save(self) -> bytes:
        """Return the state of the generator; the network does not change."""
        return pack_generator(self.name, self._generator)

    def agent_load(self, data: bytes) -> None:
        """Continue with the draws of a saved agent.

        Raises:
            SaveError: `data` is damaged, or of another agent.
        """
        self._generator = unpack_generator(data, self.name)

    def _act(self, observation: Observation) -> Action:
        seen = features(*tiles_and_sprites(observation), self._recent)
        preferred = preferences(self._network, seen)[0]
        if not self._greedy:
            # The largest after adding Gumbel noise is a draw from the softmax.
            preferred = preferred + self._generator.gumbel(size=NUM_ACTIONS)
        action = int(preferred.argmax())
        remember(self._recent, action)
        return ACTIONS[action]
