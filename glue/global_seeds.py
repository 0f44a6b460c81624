"""Python's and NumPy's global generators, seeded for a player that takes no seed of its own.

Nothing in this project draws from them. A user's agent or environment may, and is then repeatable.
"""

from __future__ import annotations

import random
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np


def seed_globals(seed: int) -> None:
    """Seed both generators.

    Args:
        seed: 0 <= seed < 2**63.
    """
    random.seed(seed)
    np.random.seed([seed & 0xFFFF_FFFF, seed >> 32])


@contextmanager
def globals_restored() -> Iterator[None]:
    """Restore the state of both generators at the end of the block."""
    python, numpy = random.getstate(), np.random.get_state()
    try:
        yield
    finally:
        random.setstate(python)
        np.random.set_state(numpy)


def take_seeds(player: Any) -> None:
    """Give an agent or environment without `agent_seed` or `env_seed` a method that seeds the generators."""
    for prefix in ("agent", "env"):
        start, seed = (getattr(player, f"{prefix}_{verb}", None) for verb in ("start", "seed"))
        if callable(start) and not callable(seed):
            try:
                setattr(player, f"{prefix}_seed", seed_globals)
            except AttributeError:  # it has __slots__
                return
