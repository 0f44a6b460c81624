"""Gymnasium: Infinite Mario single and vectorized, served environments, and batches over the wire."""

from __future__ import annotations

import multiprocessing
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from itertools import cycle
from typing import Any

import numpy as np

from benchmarks.measure import Table, count, rate, rates, ratio
from benchmarks.others import other_environments
from env_server.mario.environment import InfiniteMario
from env_server.mario.many.games import DISABLED, Games
from env_server.mario.many.views import BODY, View
from env_server.mario.observation import BODY_SIZE
from glue import (
    Action,
    Agent,
    Environment,
    Experiment,
    Observation,
    connect,
    make,
    make_agent,
    serve_agent,
    serve_environment,
)
from glue.batches import (
    Batch,
    Ragged,
    batch_task_spec,
    pack_actions,
    pack_batch,
    read_batch_task_spec,
    unpack_actions,
    unpack_batch,
)
from glue.hub.config import HubConfig
from glue.hub.io.server import Hub
from glue.plugins.batched import make_batch
from glue.types import Step

_ID = "env_server.gym:glue/InfiniteMario-v0"
_CHOICES = np.array([3, 2, 2])
_STEPS = 64_000
_SEED = 3
_INTS, _DOUBLES, _CHARS = 23, 44, 352  # an observation of Mario with ten sprites


def run() -> list[Table]:
    """Measure everything in this module."""
    import gymnasium

    return [_vector(gymnasium), _served(gymnasium), _batches()]


def _actions(games: int) -> list[Any]:
    """Return actions that run to the right and jump now and then, in the form of MultiDiscrete."""
    generator = np.random.default_rng(_SEED)
    shape = (50, games)
    parts = (
        generator.integers(1, 3, shape),
        generator.integers(0, 2, shape),
        generator.integers(0, 2, shape),
    )
    return [*np.stack(parts, 2)]


def _play(step: Callable[[Any], Any], actions: list[Any], calls: int) -> None:
    for number in range(calls):
        step(actions[number % len(actions)])


def _bare(games: int) -> Callable[[], object]:
    tasks = [InfiniteMario(level_seed=seed).parameters for seed in range(games)]
    batch = Games(tasks, View(BODY, BODY_SIZE, 0), DISABLED)
    batch.reset()

    def step(action: Any) -> None:
        batch.step(action, _CHOICES)
        ended = batch.lanes["terminated"]
        if ended.any():
            batch.reset(ended)

    return partial(_play, step, _actions(games), _STEPS // games)


def _many(gymnasium: Any, games: int, **options: Any) -> Callable[[], object]:
    envs = gymnasium.make_vec(
        _ID, num_envs=games, num_levels=games, level_type=0, level_difficulty=0, **options
    )
    envs.reset(seed=_SEED)
    return partial(_play, envs.step, _actions(games), _STEPS // games)


def _one(gymnasium: Any) -> Callable[[], object]:
    env = gymnasium.make(_ID)
    env.reset(seed=_SEED)

    def step(action: Any) -> None:
        _, _, terminated, truncated, _ = env.step(action[0])
        if terminated or truncated:
            env.reset()

    return partial(_play, step, _actions(1), _STEPS // 8)


def _vector(gymnasium: Any) -> Table:
    # It forks before there are games; otherwise each of their pages would be copied at its next use.
    envs = gymnasium.make_vec(_ID, num_envs=8, vectorization_mode="async")
    envs.reset(seed=_SEED)
    pids = [process.pid for process in envs.unwrapped.processes]
    works: dict[str, tuple[Callable[[], object], int, str, list[int]]] = {}
    """By case: the work, its number of steps, the case to compare it with, and the other processes."""
    for games in (64, 1024):
        whole = _STEPS // games * games
        bare = f"bare batch, {games} games, one thread"
        works[bare] = _bare(games), whole, bare, []
        for name, options in _OPTIONS.items():
            one = name.removesuffix(_TWO)
            against = bare if one == name else f"make_vec, {games} games, {one}"
            works[f"make_vec, {games} games, {name}"] = _many(gymnasium, games, **options), whole, against, []
    works["gymnasium.make, one game"] = _one(gymnasium), _STEPS // 8, "", []
    works["AsyncVectorEnv over 8 single games"] = partial(_play, envs.step, _actions(8), 250), 2000, "", pids
    with other_environments() as others:
        works |= {name: (ask, steps, "", [pid]) for name, (ask, steps, pid) in others.items()}
        found = rates([partial(rate, work, number, pids) for work, number, _, pids in works.values()])
    envs.close()
    speeds = dict(zip(works, found, strict=True))
    rows = [
        (
            name,
            count(speed.per_second),
            ratio(speed.per_second / speeds[against].per_second) if against not in ("", name) else "",
            f"{speed.cpu:.1f}",
        )
        for (name, speed), (_, _, against, _) in zip(speeds.items(), works.values(), strict=True)
    ]
    about = (
        "Observations and resets included; the bare batch writes observations for RL-Glue agents. The ratio "
        "is to the bare batch of as many games, and that of two threads to one thread. Others are measured "
        "where they are installed (GLUE_OTHERS)."
    )
    columns = ("case", "steps/s", "ratio", "CPU, us a step")
    return Table("Infinite Mario for Gymnasium", about, columns, rows)


_TWO = ", two threads"
_OPTIONS: dict[str, dict[str, Any]] = {
    "tiles and sprites": {},
    f"tiles and sprites{_TWO}": {"num_threads": 2},
    "tiles and sprites, copy=False": {"copy": False},
    "pixels": {"observation": "pixels"},
    f"pixels{_TWO}": {"observation": "pixels", "num_threads": 2},
}


def _served(gymnasium: Any) -> Table:
    """Measure CartPole on its own, and served to an agent in another process."""
    env = gymnasium.make("CartPole-v1")

    def alone(steps: int) -> None:
        env.reset(seed=_SEED)
        for _ in range(steps):
            _, _, terminated, truncated, _ = env.step(env.action_space.sample())
            if terminated or truncated:
                env.reset()

    with _players(_serve_cartpole, _serve_random) as (glue, pids):
        glue.rl_init(_SEED)

        def served() -> None:
            for _ in range(100):
                glue.rl_episode()

        alone_rate, served_rate = rates(
            [partial(rate, partial(alone, 2000), 2000), partial(rate, served, 2200, pids)]
        )
    rows = [
        ("gymnasium alone", count(alone_rate.per_second), f"{alone_rate.cpu:.0f}"),
        (
            "glue-env gymnasium:CartPole-v1, agent in another process",
            count(served_rate.per_second),
            f"{served_rate.cpu:.0f}",
        ),
    ]
    about = "CartPole with random actions, about 22 steps an episode."
    return Table(
        "Gymnasium's environments for RL-Glue agents", about, ("case", "steps/s", "CPU, us a step"), rows
    )


def _batches() -> Table:
    """Measure many games in one session, with environment and agent in two processes besides the hub's."""
    rows = []
    for games in (64, 256):
        for name, serve in (("glue-env mario --batch", _serve_mario), ("no rules at all", _serve_games)):
            with _players(partial(serve, games), _serve_vector) as (glue, pids):
                glue.rl_init(_SEED)
                messages = 128_000 // games
                work = partial(glue.rl_episode, messages + 1)
                (found,) = rates([partial(rate, work, messages * games, pids)])
            speed = found.per_second
            rows.append((name, str(games), count(speed), count(speed / games), f"{found.cpu:.1f}"))
    about = (
        "Observations, rewards and terminals of many games in one message, and the actions back: of Infinite "
        "Mario, and of an environment that shows as much without playing. The agent does not look at them."
    )
    columns = ("environment", "games", "steps/s", "messages/s", "CPU of all processes, us a step")
    return Table("Batches over the wire", about, columns, rows)


@contextmanager
def _players(
    environment: Callable[[str], None], agent: Callable[[str], None]
) -> Iterator[tuple[Experiment, list[int]]]:
    """Yield an experiment in the hub's process, and the processes of its players."""
    with tempfile.TemporaryDirectory() as folder:
        hub = f"ipc://{folder}/hub"
        with Hub(HubConfig(bind=(hub,))).in_background():
            context = multiprocessing.get_context("fork")
            players = [context.Process(target=serve, args=(hub,)) for serve in (environment, agent)]
            for player in players:
                player.start()
            with connect(hub) as glue:
                yield glue, [player.pid for player in players if player.pid is not None]
        for player in players:
            player.join()


def _serve_cartpole(hub: str) -> None:
    serve_environment(make("gymnasium:CartPole-v1"), hub)


def _serve_random(hub: str) -> None:
    serve_agent(make_agent("random"), hub)


def _serve_mario(games: int, hub: str) -> None:
    serve_environment(make_batch("mario", partial(make, "mario"), games), hub)


def _serve_games(games: int, hub: str) -> None:
    serve_environment(_Still(games), hub)


def _serve_vector(hub: str) -> None:
    serve_agent(_Vector(), hub)


class _Still(Environment):
    """Many games whose observations are of Mario's size, and whose rules take no time."""

    def __init__(self, games: int) -> None:
        self._games = games
        counts = np.tile(np.array([_INTS, _DOUBLES, _CHARS], np.int32), (games, 1))
        self._shown = Ragged(
            counts,
            np.ones(games * _INTS, np.int32),
            np.ones(games * _DOUBLES),
            np.ones(games * _CHARS, np.uint8),
        )

    def env_batch(self) -> int:
        return self._games

    def env_init(self) -> str:
        return batch_task_spec(self._games, "")

    def env_start(self) -> Observation:
        return pack_batch(Batch(np.zeros(self._games), np.zeros(self._games, np.int32), self._shown))

    def env_step(self, action: Action) -> Step:
        actions = unpack_actions(action, self._games)
        return Step(float(actions.ints.sum()), self.env_start(), False)


class _Vector(Agent):
    """Runs to the right in all games and jumps now and then, regardless of its observations."""

    def agent_batch(self) -> int:
        return 0

    def agent_init(self, task_spec: str) -> None:
        games, _ = read_batch_task_spec(task_spec)
        counts = np.tile(np.array([3, 0, 0], np.int32), (games, 1))
        ints = [(one - [1, 0, 0]).astype(np.int32).ravel() for one in _actions(games)]
        self._actions = cycle([Ragged(counts, one, np.empty(0), np.empty(0, np.uint8)) for one in ints])

    def agent_start(self, observation: Observation) -> Action:
        unpack_batch(observation)
        return pack_actions(next(self._actions))

    def agent_step(self, reward: float, observation: Observation) -> Action:
        return self.agent_start(observation)
