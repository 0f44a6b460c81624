"""A network that has learned from one round of states prefers cheap actions, and is reproducible."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from agents.network.agent import load, preferences

pytest.importorskip("torch", reason="it learns with PyTorch: pip install 'torch>=2.2'", exc_type=ImportError)

from studies.imitation import Player, States, learn


def test_one_round_teaches_what_is_cheap(tmp_path: Path) -> None:
    files = [str(tmp_path / f"{number}.npz") for number in range(2)]
    for file in files:
        learn(levels=1000, seed=1, count=1, out=file)
    network, again = map(load, files)
    assert all(np.array_equal(network[name], again[name]) for name in network)

    states = States()
    Player(levels=1000, seed=2).play(network, states, 3000)
    seen, prices = (part.numpy() for part in states.gathered())
    chosen = preferences(network, seen.astype(np.float32)).argmax(1)
    assert prices[np.arange(len(chosen)), chosen].mean() < prices.mean() / 2
