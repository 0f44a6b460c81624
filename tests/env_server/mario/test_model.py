"""The model of Infinite Mario against the game: equal if everything is known, and corrected if not."""

from __future__ import annotations

import numpy as np
import pytest

from env_server.mario import model
from env_server.mario.environment import InfiniteMario
from env_server.mario.game import Game
from env_server.mario.level_sets import LEVEL_SETS
from env_server.mario.observation import encode
from env_server.mario.sim.state import GOOMBA, ROWS
from glue import ConfigError, Observation
from glue.plugins.loading import find_model
from tests.env_server.mario import random_play
from tests.proof import size

TASK = InfiniteMario().parameters


class Belief:
    """A belief, and the arrays needed to step it."""

    def __init__(self) -> None:
        self.worlds, self.levels = model.make()
        self.seen = np.zeros(1, np.int64)
        self.body = np.zeros(model.BODY_SIZE, np.uint8)

    def read(self, observation: Observation) -> None:
        self.body[: len(observation.body)] = np.frombuffer(observation.body, np.uint8)

    def shows(self) -> Observation:
        body = np.zeros(model.BODY_SIZE, np.uint8)
        return Observation.from_body(body[: encode(self.worlds[0], self.levels[0], body)].tobytes())


def test_agents_find_the_model_by_the_name_of_its_environment() -> None:
    assert find_model("mario") is model
    with pytest.raises(ConfigError):
        find_model("nothing")


@pytest.mark.proof
def test_model_that_knows_everything_is_the_game() -> None:
    """Before every step the state is saved to a row of bytes and loaded from it again, as in a search."""
    rng = np.random.default_rng(1)
    belief = Belief()
    memory = belief.worlds.view(np.uint8)
    steps = 0
    worlds, levels = belief.worlds, belief.levels
    while steps < size(10_000, 1_000_000):
        number = int(rng.integers(10**6))
        game = Game(LEVEL_SETS["ladder-v1"].level(TASK, number))
        game.start()
        columns = int(game.level_map.columns)
        belief.levels[:] = game._level
        memory[:] = game._memory.view(np.uint8)
        row = np.zeros(model.row_size(columns), np.uint8)
        others = rng.integers(12, size=300).tolist()
        for other, (direction, jump, run) in zip(others, random_play.random_actions(rng, 300), strict=True):
            model.save(worlds, memory, row, 0, columns)
            model.step(worlds, levels, other)
            model.load(worlds, memory, row, 0, columns)
            alive = model.step(worlds, levels, 4 * (direction + 1) + 2 * jump + run)
            _, observation, ended, *_ = game.step(direction, jump, run)
            steps += 1
            assert alive != ended
            if ended:
                break
            belief.read(observation)
            assert model.predicts(worlds, levels, belief.body)


def test_a_level_of_which_tiles_and_spawn_points_were_saved_is_whole_again_at_the_start() -> None:
    first = Game(TASK).start()
    belief, loaded = Belief(), Belief()
    for one in (belief, loaded):
        one.read(first)
        model.start(one.worlds, one.levels, one.seen, one.body)
        belief.levels["spawns"][0, 4, 9] = GOOMBA
        loaded.seen[:] = belief.seen
        for name in ("tiles", "spawns"):
            loaded.levels[name] = belief.levels[name]
    cells, end = belief.levels["cells"][0], int(belief.seen[0])
    assert cells[:end].any()
    assert np.array_equal(loaded.levels["cells"][0, :end], cells[:end])
    spawning = (loaded.levels["spawns"][0] != 0) @ (1 << np.arange(ROWS))
    assert spawning[4] == 1 << 9
    assert np.array_equal(loaded.levels["spawning"][0], spawning)


def test_belief_follows_what_it_sees() -> None:
    """After a correction every tile and actor is where it was seen; most steps need no correction."""
    rng = np.random.default_rng(2)
    exact = steps = 0
    for number in range(20):
        belief = Belief()
        game = Game(LEVEL_SETS["train-200"].level(TASK, number))
        belief.read(game.start())
        model.start(belief.worlds, belief.levels, belief.seen, belief.body)
        for direction, jump, run in random_play.random_actions(rng, 100):
            model.step(belief.worlds, belief.levels, 4 * (direction + 1) + 2 * jump + run)
            _, observation, ended, *_ = game.step(direction, jump, run)
            if ended:
                break
            belief.read(observation)
            exact += model.correct(belief.worlds, belief.levels, belief.seen, belief.body)
            steps += 1
            shown, expected = belief.shows(), observation
            assert shown.chars == expected.chars
            assert shown.ints.tolist() == expected.ints.tolist()
            places = np.abs(shown.doubles - expected.doubles).reshape(-1, 4)
            assert places[:, :2].max() == 0
            assert places[:, 2:].max() < 1e-4
    assert exact > 0.9 * steps
