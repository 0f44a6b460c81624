"""Gymnasium's vector environments: when their next episode begins, and their infos, split for each game."""

from __future__ import annotations

from enum import Enum
from typing import Any

import numpy as np
import numpy.typing as npt

from glue.errors import ConfigError

try:
    from gymnasium.vector import AutoresetMode
except ImportError:

    class AutoresetMode(Enum):  # type: ignore[no-redef]
        """As in Gymnasium 1.1; 1.0 has none, and behaves like NEXT_STEP."""

        NEXT_STEP = "NextStep"
        SAME_STEP = "SameStep"
        DISABLED = "Disabled"


__all__ = ["AutoresetMode", "infos_of_step", "read_mode", "split"]

Flags = npt.NDArray[np.bool_]


def split(infos: dict[str, Any], count: int) -> list[dict[str, Any]]:
    """Return an info for each of `count` games, split from vector infos, which wrappers may have nested."""
    return [_one(infos, i) for i in range(count)]


def infos_of_step(infos: dict[str, Any], terminated: Flags, truncated: Flags) -> list[dict[str, Any]]:
    """Return the infos of each game after a step, as Stable-Baselines3 expects them.

    For a game whose episode is over, they are the infos of its last step and those of wrappers on the
    episode, such as its statistics, with the last observation as `terminal_observation` and with
    `TimeLimit.truncated`.

    Args:
        infos: infos of a vector environment whose episodes begin in the same step.
        terminated, truncated: which episodes are over, shape (N,).
    """
    final, last = infos.get("final_info", {}), infos.get("final_obs")
    parts = split({name: infos[name] for name in infos if "final_" not in name}, len(terminated))
    for i in np.flatnonzero(terminated | truncated).tolist():
        assert last is not None
        parts[i] |= _one(final, i)
        parts[i]["terminal_observation"] = last[i]
        parts[i]["TimeLimit.truncated"] = bool(truncated[i] and not terminated[i])
    return parts


def _one(infos: dict[str, Any], i: int) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for name, values in infos.items():
        mask = infos.get(f"_{name}")
        if not name.startswith("_") and (mask is None or mask[i]):
            found[name] = _one(values, i) if isinstance(values, dict) else values[i]
    return found


def read_mode(mode: object) -> AutoresetMode:
    """Return the mode that a user gave, as a member or by its value.

    Raises:
        ConfigError: there is no such mode.
    """
    try:
        return AutoresetMode(mode)
    except ValueError:
        known = ", ".join(repr(known.value) for known in AutoresetMode)
        raise ConfigError(f"autoreset_mode is one of {known}, not {mode!r:.80}") from None
