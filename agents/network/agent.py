"""The agent that plays only by a network, in NumPy, from the current observation.

`studies/ppo.py` and `studies/imitation.py` in the repository write its files.
"""

from __future__ import annotations

import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, ClassVar, Final

import numpy as np
import numpy.typing as npt

from agents.mario.agent import ACTIONS, NUM_ACTIONS, MarioAgent, legal_actions
from agents.network.features import FEATURES, NONE, RECENT, Reals, features, remember, tiles_and_sprites
from glue.errors import ConfigError
from glue.options import Option
from glue.saves import pack_generator, unpack_generator
from glue.types import Action, Observation

_SHIPPED: Final = str(Path(__file__).with_name("policy.npz"))
WIDTHS: Final = (256, 128)
"""Widths of the hidden layers of a network in training."""
LAYERS: Final = len(WIDTHS) + 1


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
    agent_masks = True

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
        if observation.packed_mask:
            preferred = np.where(legal_actions(observation), preferred, -np.inf)
        action = int(preferred.argmax())
        remember(self._recent, action)
        return ACTIONS[action]


Network = Mapping[str, Reals]
"""The weights (inputs, outputs) and biases (outputs,) of each layer: `weight0`, `bias0`, and so on."""


def preferences(network: Network, seen: Reals) -> Reals:
    """Return the preference of each action, shape (N, 12), for the inputs `seen`, shape (N, FEATURES)."""
    for layer in range(LAYERS):
        seen = seen @ network[f"weight{layer}"] + network[f"bias{layer}"]
        if layer < LAYERS - 1:
            seen = np.maximum(seen, 0)
    return seen


def save(network: Network, path: str) -> None:
    """Write a network in half precision; nothing in the file is executed when it is read."""
    halves: dict[str, Any] = {name: weights.astype(np.float16) for name, weights in network.items()}
    np.savez_compressed(path, **halves)


def load(path: str) -> Network:
    """Read a network.

    Raises:
        ConfigError: the file is missing, or holds no such network.
    """
    network: dict[str, Reals] = {}
    try:
        with np.load(path, allow_pickle=False) as saved:
            width = FEATURES
            for layer in range(LAYERS):
                weight, bias = _checked(saved[f"weight{layer}"]), _checked(saved[f"bias{layer}"])
                if weight.shape != (width, len(bias)):
                    raise ValueError(f"layer {layer} has weights {weight.shape}, not {(width, len(bias))}")
                network |= {f"weight{layer}": weight, f"bias{layer}": bias}
                width = len(bias)
        if width != NUM_ACTIONS:
            raise ValueError(f"it has {width} outputs, not {NUM_ACTIONS}")
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile) as error:
        raise ConfigError(
            f"policy is not the file of a network for the agent network: {path!r}: {error}"
        ) from None
    return network


def _checked(array: npt.NDArray[np.float32]) -> Reals:
    if array.dtype not in (np.float16, np.float32) or not np.isfinite(array).all():
        raise ValueError("its numbers are not finite single or half precision")
    return array.astype(np.float32)
