"""The network: layers of weights in NumPy, and the file that holds them."""

from __future__ import annotations

import zipfile
from collections.abc import Mapping
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from agents.mario.actions import NUM_ACTIONS
from agents.network.features import FEATURES, Reals
from glue.errors import ConfigError

WIDTHS: Final = (256, 128)
"""Widths of the hidden layers of a network in training."""
LAYERS: Final = len(WIDTHS) + 1

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
