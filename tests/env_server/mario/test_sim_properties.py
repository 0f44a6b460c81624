"""Properties of every game: it depends only on its task and its actions, and can be copied at any point."""

from __future__ import annotations

import json
import os
import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from env_server.mario.game import Game
from glue.types import Observation
from tests.env_server.mario import random_play

Step = tuple[float, Observation, bool]
Actions = list[list[int]]

RANDOM_STEPS = 1_000_000

_SEEDS = st.integers(0, 2**32 - 1)


def make(seed: int, steps: int) -> tuple[Game, Actions]:
    rng = np.random.default_rng(seed)
    return Game(random_play.random_task(rng)), random_play.random_actions(rng, steps)


def play(game: Game, actions: Actions) -> list[Step]:
    """Execute the actions, starting again after each end."""
    steps: list[Step] = []
    for action in actions:
        steps.append(game.step(*action))
        if steps[-1][2]:
            game.start()
    return steps


@settings(deadline=None)
@given(seed=_SEEDS, before=_SEEDS)
def test_same_task_and_actions_give_the_same_bytes(seed: int, before: int) -> None:
    first, actions = make(seed, 60)
    start = first.start()
    expected = play(first, actions)
    other, others_actions = make(before, 60)
    other.start()
    play(other, others_actions)
    again, _ = make(seed, 60)
    assert again.start() == start
    assert play(again, actions) == expected


@settings(deadline=None)
@given(seed=_SEEDS, at=st.integers(0, 100))
def test_restored_game_continues_as_if_never_stopped(seed: int, at: int) -> None:
    game, actions = make(seed, 100)
    game.start()
    play(game, actions[:at])
    saved = game.clone()
    expected = play(game, actions[at:])
    assert play(saved.clone(), actions[at:]) == expected
    game.restore(saved)
    assert play(game, actions[at:]) == expected


def test_restored_end_is_still_an_end() -> None:
    game, _ = make(1, 0)
    game.world.max_trial_steps = 1
    game.world.draws_at_checkins = False
    last = game.start()
    saved = game.clone()
    assert game.step(0, 0, 0) == (-10.0, last, True)
    game.restore(saved)
    assert game.step(1, 1, 1) == (-10.0, last, True)


@pytest.mark.stage("proof")  # its code has to be compiled
@pytest.mark.proof
def test_random_steps_stay_in_bounds() -> None:
    run = subprocess.run(
        [sys.executable, "-W", "error", random_play.__file__ or "", str(RANDOM_STEPS)],
        env={**os.environ, "NUMBA_BOUNDSCHECK": "1"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert run.returncode == 0, run.stderr
    assert json.loads(run.stdout)["steps"] >= RANDOM_STEPS
