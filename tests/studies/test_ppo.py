"""PPO: the same seed learns the same, and an initial network is unchanged until its values are known."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from agents.network.agent import Network, load, save
from tests.agents.network.test_network import arrays

pytest.importorskip("torch", reason="it learns with PyTorch: pip install 'torch>=2.2'", exc_type=ImportError)
pytest.importorskip(
    "gymnasium", reason="it needs Gymnasium: pip install 'glue-rl[gym]'", exc_type=ImportError
)

from studies import ppo


def learned(file: Path, seed: int = 1, updates: int = 1, start: str = "") -> Network:
    ppo.learn("1000", seed, updates * ppo.GAMES * ppo.LENGTH, start, str(file))
    return load(str(file))


def same(one: Network, other: Network) -> bool:
    return all(np.array_equal(one[name], other[name]) for name in one)


def test_the_same_seed_learns_the_same(tmp_path: Path) -> None:
    first, again, other = (learned(tmp_path / f"{n}.npz", seed) for n, seed in enumerate((1, 1, 2)))
    assert same(first, again)
    assert not same(first, other)


def test_a_network_to_begin_with_plays_until_its_values_are_known(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(ppo, "WIDTHS", (16, 8))
    monkeypatch.setattr(ppo, "VALUES_ONLY", 1)
    start = tmp_path / "start.npz"
    save(arrays(), str(start))
    assert same(learned(tmp_path / "one.npz", start=str(start)), load(str(start)))
    assert not same(learned(tmp_path / "two.npz", updates=2, start=str(start)), load(str(start)))
