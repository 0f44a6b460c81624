"""The agent that plays with a network: its inputs, its actions, and files that hold no network."""

from __future__ import annotations

import zipfile
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from agents.network.agent import (
    FEATURES,
    RECENT,
    NetworkAgent,
    features,
    load,
    preferences,
    save,
    tiles_and_sprites,
)
from env_server.mario import InfiniteMario
from env_server.mario.level_sets import LEVEL_SETS
from env_server.mario.many.games import SAME_STEP, Games
from env_server.mario.many.views import VIEWS
from glue import ConfigError, local

Arrays = dict[str, npt.NDArray[Any]]


def arrays() -> Arrays:
    """Return a network of random weights, in half precision, as in the file."""
    random = np.random.default_rng(0)
    widths = (FEATURES, 16, 8, 12)
    sizes = {f"weight{i}": widths[i : i + 2] for i in range(3)} | {
        f"bias{i}": widths[i + 1 : i + 2] for i in range(3)
    }
    return {name: random.normal(size=size).astype(np.float16) for name, size in sizes.items()}


@pytest.fixture
def policy(tmp_path: Path) -> Path:
    save(arrays(), str(tmp_path / "network.npz"))
    return tmp_path / "network.npz"


def test_an_observation_is_seen_as_the_view_of_learners_shows_it() -> None:
    task, random = InfiniteMario().parameters, np.random.default_rng(1)
    games = Games([LEVEL_SETS["train-200"].level(task, 9)], VIEWS["tiles"], SAME_STEP)
    games.seed(0, 0)
    games.reset()
    others = 0
    for _ in range(400):
        tiles, sprites = games.cells.reshape(1, 16, 21), games.reals.reshape(1, 16, 7)
        if not games.lanes["over"][0]:
            ours = tiles_and_sprites(games.observation(0))
            assert np.array_equal(ours[0], tiles)
            np.testing.assert_allclose(ours[1], sprites, rtol=1e-6, atol=1e-6)
            others = max(others, int(sprites[0, :, 0].sum()))
        games.step(random.integers(4, 12, (1, 1)), np.array([12]))
    assert others > 2


def test_the_network_is_what_its_file_says(policy: Path) -> None:
    environment = InfiniteMario()
    environment.env_init()
    expected = seen = features(*tiles_and_sprites(environment.env_start()), np.zeros((1, RECENT), np.int64))
    for i in range(3):
        expected = expected @ arrays()[f"weight{i}"].astype(np.float32) + arrays()[f"bias{i}"]
        expected = expected if i == 2 else np.maximum(expected, 0)
    assert np.allclose(preferences(load(str(policy)), seen), expected, rtol=1e-5)


def actions(agent: NetworkAgent, seed: int) -> list[tuple[int, ...]]:
    """Return an agent's actions in an episode that always begins the same way."""
    with local(agent, InfiniteMario(level_seed=3)) as glue:
        glue.rl_init(seed)
        glue.rl_start()
        return [tuple(glue.rl_step().action.ints) for _ in range(40)]


def test_actions_are_drawn_with_the_seed_or_taken_without_it(tmp_path: Path) -> None:
    undecided = str(tmp_path / "undecided.npz")
    save({name: array.astype(np.float32) / np.float32(100) for name, array in arrays().items()}, undecided)
    drawing, greedy = NetworkAgent(policy=undecided), NetworkAgent(policy=undecided, greedy=True)
    assert actions(drawing, 1) == actions(drawing, 1) != actions(drawing, 2)
    assert actions(greedy, 1) == actions(greedy, 2)


def test_the_policy_that_comes_with_the_package_reaches_goals_that_it_has_not_seen() -> None:
    task, agent, levels = InfiniteMario().parameters, NetworkAgent(), LEVEL_SETS["test-1000"]
    won = 0
    for number in levels.numbers[:30]:
        with local(agent, InfiniteMario(**asdict(levels.level(task, number)))) as glue:
            glue.rl_init(1)
            glue.rl_episode(2000)
            won += glue.rl_return() > 50  # the goal is worth 100
    assert won >= 10


@pytest.mark.parametrize(
    "spoil",
    [
        lambda saved: saved.pop("bias1"),
        lambda saved: saved.update(weight0=saved["weight0"][1:]),
        lambda saved: saved.update(weight1=saved["weight1"].astype(np.float64)),
        lambda saved: saved.update(bias2=saved["bias2"] * np.float16(np.nan)),
        lambda saved: saved.update(bias2=np.array([None] * 12)),
        lambda saved: saved.update(weight2=saved["weight2"][:, :5], bias2=saved["bias2"][:5]),
    ],
)
def test_a_file_that_is_no_network_is_refused(tmp_path: Path, spoil: Callable[[Arrays], object]) -> None:
    saved: dict[str, Any] = arrays()
    spoil(saved)
    np.savez(tmp_path / "network.npz", **saved)
    with pytest.raises(ConfigError, match="network"):
        NetworkAgent(policy=str(tmp_path / "network.npz"))


def header(shape: str) -> bytes:
    text = f"{{'descr': '<f2', 'fortran_order': False, 'shape': {shape}, }}".ljust(117) + "\n"
    return b"\x93NUMPY\x01\x00v\x00" + text.encode()


@pytest.mark.parametrize("weights", [b"no array", header("()") + b"..", header("(10**12, 1)"), header("(((")])
def test_an_array_that_is_none_is_refused(tmp_path: Path, weights: bytes) -> None:
    with zipfile.ZipFile(tmp_path / "network.npz", "w") as archive:
        archive.writestr("weight0.npy", weights)
        archive.writestr("bias0.npy", header("()") + b"..")
    with pytest.raises(ConfigError, match="policy"):
        NetworkAgent(policy=str(tmp_path / "network.npz"))


def test_a_file_that_unpacks_to_more_than_a_network_has_is_not_unpacked(tmp_path: Path) -> None:
    archive = zipfile.ZipFile(tmp_path / "network.npz", "w", zipfile.ZIP_DEFLATED)
    with archive, archive.open("weight0.npy", "w") as member:
        for _ in range(257):
            member.write(bytes(2**20))
    with pytest.raises(ConfigError, match="unpacks to 269,484,032 bytes"):
        NetworkAgent(policy=str(tmp_path / "network.npz"))


@pytest.mark.parametrize("content", [None, b"", b"no archive", b"\x93NUMPY\x01\x00"])
def test_a_missing_or_damaged_file_is_refused(tmp_path: Path, content: bytes | None) -> None:
    path = tmp_path / "network.npz"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(ConfigError, match="policy"):
        NetworkAgent(policy=str(path))


def test_a_file_with_damaged_bytes_is_refused(policy: Path) -> None:
    whole = policy.read_bytes()
    for at in range(60, 260, 20):
        policy.write_bytes(whole[:at] + b"\xff" * 8 + whole[at + 8 :])
        with pytest.raises(ConfigError, match="policy"):
            load(str(policy))
