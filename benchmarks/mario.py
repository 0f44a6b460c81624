"""Infinite Mario: steps per second directly, through `glue.local` and in batches; start-up time."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from itertools import cycle

import numpy as np
import numpy.typing as npt

from benchmarks.measure import Table, count, medians, ratio
from env_server.mario import model
from env_server.mario.environment import InfiniteMario
from env_server.mario.many.games import DISABLED, Games
from env_server.mario.many.views import BODY, View
from glue.compiled.jit import entry
from glue.compiled.records import Array
from glue.engine.local import local
from glue.roles import Agent
from glue.types import Action, Observation

# Running right and jumping in four of every seven steps takes Mario through this level to its goal.
_LEVEL_SEED = 3
_BUTTONS = [(1, int(i % 7 < 4), 1) for i in range(7)]
_ACTIONS = [Action(ints=buttons) for buttons in _BUTTONS]
_CHOICES = np.array([3, 2, 2])
_STEPS = 50_000
_PATH = 12  # steps
_WINDOW = 72  # columns, as in the planner's search
Bytes = npt.NDArray[np.uint8]
model_load, model_save, model_step = model.load, model.save, model.step
_FIRST_STEP = """
from env_server.mario.environment import InfiniteMario
from glue.types import Action
mario = InfiniteMario()
mario.env_init()
mario.env_start()
mario.env_step(Action(ints=[1, 0, 1]))
"""


class _Runner(Agent):
    """An agent that always does the same and learns nothing."""

    def agent_start(self, observation: Observation) -> Action:
        self._actions = cycle(_ACTIONS)
        return next(self._actions)

    def agent_step(self, reward: float, observation: Observation) -> Action:
        return next(self._actions)


def run() -> list[Table]:
    """Measure everything about Mario."""
    return [_steps(), _copies(), _model_steps(), _readiness()]


def _steps() -> Table:
    sizes = (1, 64, 1024)
    measures = {
        "one game": _alone,
        "one game through glue.local": _through_glue,
        **{f"a batch of {games} in one call": _batched(games) for games in sizes},
    }
    values = medians(list(measures.values()))
    return Table(
        "Infinite Mario",
        "Steps of five ticks per second, observation included; Mario runs right and reaches the goal.",
        ("", "steps per second", "times one game"),
        [
            (name, count(value), ratio(value / values[0]))
            for name, value in zip(measures, values, strict=True)
        ],
    )


def _alone() -> float:
    mario = InfiniteMario(level_seed=_LEVEL_SEED)
    mario.env_init()
    steps = 0
    began = time.perf_counter()
    while steps < _STEPS:
        mario.env_start()
        for action in cycle(_ACTIONS):
            steps += 1
            if mario.env_step(action)[2]:
                break
    return steps / (time.perf_counter() - began)


def _through_glue() -> float:
    with local(_Runner(), InfiniteMario(level_seed=_LEVEL_SEED)) as glue:
        glue.rl_init()
        steps = 0
        began = time.perf_counter()
        while steps < _STEPS:
            glue.rl_episode(0)
            steps += glue.rl_num_steps()
        return steps / (time.perf_counter() - began)


def _batched(games: int) -> Callable[[], float]:
    def measure() -> float:
        tasks = [InfiniteMario(level_seed=_LEVEL_SEED).parameters] * games
        view, threads = View(BODY, model.BODY_SIZE, 0), 1 if games < 1024 else 2
        with Games(tasks, view, DISABLED, threads=threads) as batch:
            batch.reset()
            actions = [np.tile((2, *buttons[1:]), (games, 1)) for buttons in _BUTTONS]
            steps = 0
            began = time.perf_counter()
            while steps < _STEPS:
                for action in cycle(actions):
                    steps += games
                    batch.step(action, _CHOICES)
                    if batch.lanes["terminated"][0]:  # and so have all, as they do the same
                        batch.reset()
                        break
            return steps / (time.perf_counter() - began)

    return measure


def _copies() -> Table:
    mario = InfiniteMario(level_seed=_LEVEL_SEED)
    mario.env_init()
    mario.env_start()
    game, saved = mario.game, mario.game.clone()
    measures: dict[str, Callable[[], object]] = {
        "clone a game": game.clone,
        "restore a game": lambda: game.restore(saved),
        "start an episode, level included": mario.env_start,
    }
    values = medians([_microseconds(measure) for measure in measures.values()])
    return Table(
        "Copying a game",
        f"A game is {game.world.nbytes:,} bytes of memory.",  # type: ignore[attr-defined]
        ("", "µs"),
        [(name, f"{value:.1f}") for name, value in zip(measures, values, strict=True)],
    )


def _model_steps() -> Table:
    mario = InfiniteMario(level_seed=_LEVEL_SEED)
    mario.env_init()
    body = np.zeros(model.BODY_SIZE, np.uint8)
    seen = np.frombuffer(mario.env_start().body, np.uint8)
    body[: len(seen)] = seen
    worlds, levels = model.make()
    model.start(worlds, levels, np.zeros(1, np.int64), body)
    begun = worlds.copy()
    rows = np.zeros((2, model.row_size(_WINDOW)), np.uint8)

    def measure() -> float:
        worlds[:] = begun
        model.save(worlds, worlds.view(np.uint8), rows[0], 0, _WINDOW)
        began = time.perf_counter()
        _step_with_copies(worlds, levels, worlds.view(np.uint8), rows, _STEPS)
        return (time.perf_counter() - began) / _STEPS * 1e6

    measure()  # compiles
    return Table(
        "A step of the model",
        "A world is loaded, stepped with an action and saved, as the planner does for each node of its "
        "search; Mario runs and jumps over the first 12 steps of a level, again and again (the aim is 5 µs).",
        ("", "µs"),
        [("load, step and save", f"{medians([measure])[0]:.2f}")],
    )


@entry
def _step_with_copies(worlds: Array, levels: Array, memory: Bytes, rows: Bytes, steps: int) -> int:
    alive = 0
    for i in range(steps):
        at = i % _PATH
        model_load(worlds, memory, rows[min(at, 1)], 0, _WINDOW)
        alive += model_step(worlds, levels, 11 if i % 7 < 4 else 9)
        model_save(worlds, memory, rows[1], 0, _WINDOW)
    return alive


def _microseconds(call: Callable[[], object], times: int = 2000) -> Callable[[], float]:
    def measure() -> float:
        began = time.perf_counter()
        for _ in range(times):
            call()
        return (time.perf_counter() - began) / times * 1e6

    return measure


def _readiness() -> Table:
    with tempfile.TemporaryDirectory() as folder:
        _first_step(folder)
        warm, cold = medians([lambda: _first_step(folder), _first_step_ever])
    return Table(
        "Ready to play",
        "Seconds from the start of a Python process to the end of its first step (the aims are 2 and 30).",
        ("", "seconds"),
        [("compiled before", f"{warm:.2f}"), ("first time ever, compiling", f"{cold:.1f}")],
    )


def _first_step_ever() -> float:
    with tempfile.TemporaryDirectory() as folder:
        return _first_step(folder)


def _first_step(cache: str) -> float:
    began = time.perf_counter()
    environment = {**os.environ, "NUMBA_CACHE_DIR": cache}
    subprocess.run([sys.executable, "-c", _FIRST_STEP], env=environment, check=True, capture_output=True)
    return time.perf_counter() - began
