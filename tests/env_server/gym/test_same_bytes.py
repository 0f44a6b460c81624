"""The same game, the same bytes: through Gymnasium, in process, through a hub, in batches of any size."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from typing import Any

import numpy as np
import pytest

from glue import Action, Agent, Environment, Observation, local, make
from glue.batches import Ragged, pack_actions, unpack_batch
from glue.engine.experiment import Experiment
from glue.plugins.batched import BatchedEnvironments
from tests.hubs import hub_with, over_the_hub

gymnasium: Any = pytest.importorskip("gymnasium", reason="needs Gymnasium: the extra gym")
import glue.gym  # noqa: E402

ID = "env_server.gym:glue/InfiniteMario-v0"
TASK: dict[str, Any] = {"level_seed": 7, "level_type": 1, "level_difficulty": 2, "max_trial_steps": 50}
SEED = 3

Outcome = tuple[float, bool, bytes]
"""Reward, whether the episode ended, and the observation after the step, of the next episode if it ended."""
Glue = Callable[[Agent, Environment], AbstractContextManager[Experiment]]


def actions() -> Iterator[list[int]]:
    """Yield directions and buttons of 130 steps, at least two ends among them."""
    generator = np.random.default_rng(SEED)
    for _ in range(130):
        yield [int(generator.integers(0, 2)), int(generator.integers(0, 2)), int(generator.integers(0, 2))]


def body(shown: Any) -> bytes:
    """Return the wire form of an observation of the raw view, or of an environment without spaces."""
    actors = int(shown["actors"][0]) if "actors" in shown else len(shown["doubles"]) // 4
    ints, doubles = shown["ints"][: 1 + 2 * actors], shown["doubles"][: 4 * actors]
    return Observation(ints, doubles, shown["chars"].tobytes()).body


def played(env: Any, move: Callable[[list[int]], Any]) -> list[Outcome]:
    """Play a single Gymnasium environment."""
    outcomes: list[Outcome] = [(0.0, False, body(env.reset(seed=SEED)[0]))]
    for action in actions():
        shown, reward, terminated, truncated, _ = env.step(move(action))
        if terminated or truncated:
            shown, _ = env.reset()
        outcomes.append((float(reward), terminated, body(shown)))
    env.close()
    return outcomes


def of_gymnasium() -> list[Outcome]:
    return played(gymnasium.make(ID, observation="raw", **TASK), lambda action: [action[0] + 1, *action[1:]])


def through_gymnasium_and_a_hub() -> list[Outcome]:
    with hub_with(make("mario", **TASK)) as hub:
        env = glue.gym.connect(hub)
        spaces = env.action_space
        return played(env, lambda action: np.array(action, spaces.dtype))


def of_a_vector(count: int, threads: int, game: int) -> list[Outcome]:
    envs = gymnasium.make_vec(
        ID, num_envs=count, num_threads=threads, observation="raw", autoreset_mode="SameStep", **TASK
    )

    def one(shown: Any) -> bytes:
        return body({name: part[game] for name, part in shown.items()})

    outcomes: list[Outcome] = [(0.0, False, one(envs.reset(seed=SEED)[0]))]
    for action in actions():
        shown, rewards, terminated, _, _ = envs.step(np.array([[action[0] + 1, *action[1:]]] * count))
        outcomes.append((float(rewards[game]), bool(terminated[game]), one(shown)))
    envs.close()
    return outcomes


class StandIn(Agent):
    """An agent of one game or of many, for an experiment that acts itself."""

    def agent_batch(self) -> int:
        return 0

    def agent_start(self, observation: Observation) -> Action:
        return Action()

    def agent_step(self, reward: float, observation: Observation) -> Action:
        return Action()


def of_one(way: Glue) -> list[Outcome]:
    with way(StandIn(), make("mario", **TASK)) as experiment:
        experiment.rl_init(SEED)
        outcomes: list[Outcome] = [(0.0, False, experiment.rl_env_start().body)]
        for action in actions():
            reward, shown, terminal, *_ = experiment.rl_env_step(Action(action))
            if terminal:
                shown = experiment.rl_env_start()
            outcomes.append((reward, bool(terminal), shown.body))
        return outcomes


def of_a_batch(way: Glue, count: int) -> list[Outcome]:
    games = BatchedEnvironments([make("mario", **TASK) for _ in range(count)])
    with way(StandIn(), games) as experiment:
        experiment.rl_init(SEED)
        batch = unpack_batch(experiment.rl_env_start())
        outcomes: list[Outcome] = [(0.0, False, batch.observations.values(Observation)[-1].body)]
        for action in actions():
            _, shown, *_ = experiment.rl_env_step(pack_actions(Ragged.of([Action(action)] * count)))
            batch = unpack_batch(shown)
            last = batch.observations.values(Observation)[count - 1]
            outcomes.append((float(batch.rewards[-1]), bool(batch.terminals[-1]), last.body))
        return outcomes


WAYS: dict[str, Callable[[], list[Outcome]]] = {
    "through Gymnasium and a hub": through_gymnasium_and_a_hub,
    "in process": lambda: of_one(local),
    "through a hub": lambda: of_one(over_the_hub),
    "in a batch of one": lambda: of_a_vector(1, 1, 0),
    "in a batch of five, by two threads": lambda: of_a_vector(5, 2, 4),
    "in a batch of three, in process": lambda: of_a_batch(local, 3),
    "in a batch of four, through a hub": lambda: of_a_batch(over_the_hub, 4),
}


@pytest.fixture(scope="module")
def expected() -> list[Outcome]:
    """Return the outcomes with Gymnasium only, in this process."""
    outcomes = of_gymnasium()
    assert sum(ended for _, ended, _ in outcomes) >= 2
    return outcomes


@pytest.mark.parametrize("way", WAYS)
def test_the_same_seed_gives_the_same_bytes(way: str, expected: list[Outcome]) -> None:
    assert WAYS[way]() == expected
