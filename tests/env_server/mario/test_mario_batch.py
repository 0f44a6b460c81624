"""A batch plays each game as if it were the only one."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator

import numpy as np
import pytest

from env_server.mario.environment import InfiniteMario
from env_server.mario.game import Game
from env_server.mario.many.batch import MarioBatch
from glue.errors import SimulatorError
from tests.env_server.mario import random_play


@pytest.fixture
def batch() -> Iterator[MarioBatch]:
    with MarioBatch([InfiniteMario(level_seed=seed).parameters for seed in range(3)]) as batch:
        yield batch


@pytest.mark.parametrize("threads", [1, 2, 3])
def test_games_play_as_they_do_alone(threads: int) -> None:
    rng = np.random.default_rng(5)
    tasks = [random_play.random_task(rng) for _ in range(7)]
    actions = np.array([random_play.random_actions(rng, 150) for _ in tasks])
    alone = [Game(task) for task in tasks]
    with MarioBatch(tasks, threads=threads) as batch:
        batch.start()
        for i, game in enumerate(alone):
            assert batch.observation(i) == game.start()
        for step in range(150):
            rewards, ended = batch.step(actions[:, step])
            for i, game in enumerate(alone):
                expected = game.step(*actions[i, step].tolist())
                assert (rewards[i], batch.observation(i), ended[i]) == expected
                if ended[i]:
                    game.start()
            batch.start(ended)


def test_action_out_of_bounds_is_refused_and_no_game_moves(batch: MarioBatch) -> None:
    batch.start()
    before = [batch.observation(i) for i in range(3)]
    actions = np.zeros((3, 3), np.int32)
    actions[1, 0] = 2
    with pytest.raises(SimulatorError, match=r"\[2, 0, 0\] for game 1"):
        batch.step(actions)
    with pytest.raises(SimulatorError, match=r"shape \(3, 3\), not \(2, 3\)"):
        batch.step(actions[:2])
    assert [batch.observation(i) for i in range(3)] == before


def test_a_batch_plays_uncompiled() -> None:
    code = (
        "from env_server.mario.environment import InfiniteMario as M; "
        "from env_server.mario.many.batch import MarioBatch; "
        "import numpy as np; b = MarioBatch([M().parameters] * 2, threads=2); b.start(); "
        "print(b.step(np.zeros((2, 3), int))[0].tolist())"
    )
    environment = {**os.environ, "NUMBA_DISABLE_JIT": "1"}
    command = [sys.executable, "-W", "ignore", "-c", code]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=120, check=False)
    assert done.stdout == "[-0.01, -0.01]\n", done.stderr
