"""Gymnasium's modes of beginning the next episode in a vector environment.

Gymnasium 1.0 has none, and behaves like NEXT_STEP.
"""

from __future__ import annotations

from enum import Enum

from glue.errors import ConfigError

try:
    from gymnasium.vector import AutoresetMode
except ImportError:

    class AutoresetMode(Enum):  # type: ignore[no-redef]
        """As in Gymnasium 1.1."""

        NEXT_STEP = "NextStep"
        SAME_STEP = "SameStep"
        DISABLED = "Disabled"


__all__ = ["AutoresetMode", "read_mode"]


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
