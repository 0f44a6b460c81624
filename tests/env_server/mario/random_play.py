"""Play random actions with random parameters, and check the shape of every observation.

As a program, `NUMBA_BOUNDSCHECK=1 python random_play.py STEPS`, it checks every index of the rules.
"""

from __future__ import annotations

import json
import math
import struct
import sys
from dataclasses import replace

import numpy as np

from env_server.mario.game import Game
from env_server.mario.parameters import Parameters, resolve
from env_server.mario.sim.state import ACTORS
from glue.types import Observation

_COUNTS = struct.Struct("<4I")


def random_task(rng: np.random.Generator) -> Parameters:
    """Return a task from anywhere in the bounds of the options; about half are near the published ones."""
    wild = rng.random() < 0.5
    jump = rng.uniform(-16, 16, 2) if wild else rng.uniform(-4, -1, 2)
    return replace(
        resolve({}),
        level_seed=int(rng.integers(-(2**31), 2**31)),
        level_type=int(rng.integers(3)),
        level_difficulty=int(rng.integers(101 if wild else 16)),
        level_width=int(rng.integers(2001)) if rng.random() < 0.1 else int(rng.integers(400)),
        max_trial_steps=int(rng.integers(1, 2000)),
        speed_walk=float(rng.uniform(0, 16 if wild else 2)),
        speed_run=float(rng.uniform(0, 16 if wild else 3)),
        speed_jump=float(jump[0]),
        speed_slidejump=float(jump[1]),
        accel_fall=float(rng.uniform(0, 1) if wild else rng.choice([0.42, 0.82, 0.92])),
        jump_time=int(rng.integers(-100, 101) if wild else rng.integers(5, 16)),
        slidejump_time=int(rng.integers(-100, 101) if wild else -6),
        render=str(rng.choice(["tick", "checkin"])),
        alpha=float(rng.random()),
        start_ticks=int(rng.choice([5, 10])),
        velocity=str(rng.choice(["source", "jar"])),
    )


def random_actions(rng: np.random.Generator, length: int) -> list[list[int]]:
    """Return actions that are each held for some steps, with a bias to one side."""
    lean = rng.dirichlet([1, 0.3, 2])
    drawn = np.stack(
        [rng.choice([-1, 0, 1], length, p=lean), rng.integers(2, size=length), rng.integers(2, size=length)],
        1,
    )
    held: list[list[int]] = np.repeat(drawn, rng.integers(1, 6, length), axis=0)[:length].tolist()
    return held


def check_counts(observation: Observation) -> int:
    """Return how many actors are reported; the counts must fit each other and the length."""
    ints, doubles, chars, reserved = _COUNTS.unpack_from(observation.body)
    actors = doubles // 4
    assert (ints, doubles, chars, reserved) == (1 + 2 * actors, 4 * actors, 352, 0)
    assert len(observation.body) == 16 + 8 * doubles + 4 * ints + chars
    assert 1 <= actors <= ACTORS
    return int(actors)


def check_values(observation: Observation, columns: int) -> None:
    """Assert that every number of an observation is in its range."""
    kinds, wings = observation.ints[1::2], observation.ints[2::2]
    assert 0 <= observation.ints[0] <= columns - 20
    assert kinds[0] in (0, 10, 11)
    assert all(1 <= kind <= 9 for kind in kinds[1:])
    assert set(wings.tolist()) <= {0, 1}
    assert all(math.isfinite(value) for value in observation.doubles)
    rows = observation.chars.split(b"\n")
    assert [len(row) for row in rows] == [21] * 16 + [0]
    assert set(observation.chars) <= set(b"M!$b?|1237 \n")


def play(steps: int, seed: int) -> dict[str, int]:
    """Play `steps` steps; return counts of steps, episodes and so on."""
    rng = np.random.default_rng(seed)
    met = {"steps": 0, "episodes": 0, "tasks": 0, "most actors": 0}
    while met["steps"] < steps:
        game = Game(random_task(rng))
        met["tasks"] += 1
        for _ in range(3):
            check_values(game.start(), game.level_map.columns)
            met["episodes"] += 1
            for i, action in enumerate(random_actions(rng, 400)):
                reward, observation, ended, *_ = game.step(*action)
                met["steps"] += 1
                met["most actors"] = max(met["most actors"], check_counts(observation))
                assert math.isfinite(reward)
                if i % 32 == 0:
                    check_values(observation, game.level_map.columns)
                if ended:
                    break
    return met


if __name__ == "__main__":
    json.dump(play(int(sys.argv[1]), 1), sys.stdout)
