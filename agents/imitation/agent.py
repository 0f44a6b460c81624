"""The agent that imitates a search: a small network, in NumPy, over what is seen now.

`python -m experiment_runner.study.generalisation.imitation` makes its file.
"""

from __future__ import annotations

import zipfile
from collections.abc import Mapping
from typing import Annotated, Any, ClassVar, Final

import numpy as np
import numpy.typing as npt

from agents.imitation.features import FEATURES, NONE, RECENT, Reals, features, remember
from agents.mario.actions import ACTIONS, NUM_ACTIONS
from agents.mario.agent import MarioAgent
from agents.mario.views import tiles_and_sprites
from glue.errors import ConfigError
from glue.options import Option
from glue.types import Action, Observation

LAYERS: Final = 3


class ImitationAgent(MarioAgent):
    """Takes the action that its network expects to cost the fewest steps.

    Args:
        policy: the file of the network.

    Raises:
        ConfigError: the file is missing, or holds no such network.
    """

    name: ClassVar[str] = "imitation"

    def __init__(self, *, policy: Annotated[str, Option("file of the network")] = "") -> None:
        super().__init__(None)
        self._network = load(policy)
        self._reset()

    def _reset(self) -> None:
        self._recent = np.full((1, RECENT), NONE, np.int64)

    def agent_start(self, observation: Observation) -> Action:
        self._recent[:] = NONE
        return self._act(observation)

    def agent_step(self, reward: float, observation: Observation) -> Action:
        return self._act(observation)

    def _act(self, observation: Observation) -> Action:
        seen = features(*tiles_and_sprites(observation), self._recent)
        action = int(costs(self._network, seen)[0].argmin())
        remember(self._recent, action)
        return ACTIONS[action]


Network = Mapping[str, Reals]
"""The weights (inputs, outputs) and biases (outputs,) of each layer: `weight0`, `bias0`, and so on."""


def costs(network: Network, seen: Reals) -> Reals:
    """Return how many steps more than the best each action is expected to cost, shape (N, 12)."""
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
            f"policy is not the file of a network for the agent imitation: {path!r}: {error}"
        ) from None
    return network


def _checked(array: npt.NDArray[np.float32]) -> Reals:
    if array.dtype not in (np.float16, np.float32) or not np.isfinite(array).all():
        raise ValueError("its numbers are not finite single or half precision")
    return array.astype(np.float32)
