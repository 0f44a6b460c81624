"""Tests of every agent of the paper: it refuses other tasks, is reproducible, saves, loads, and learns."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from agents.mario.sample import SampleAgent
from agents.mohan2010.flat import ObjectsFlatAgent, TilesAgent, TilesCoarseAgent
from agents.mohan2010.hierarchical import (
    HierarchicalAgent,
    HierarchicalFactsAgent,
    HierarchicalInternalAgent,
    HierarchicalProgrammedAgent,
    ObjectsCoarseAgent,
)
from agents.mohan2010.learner import MarioLearner
from env_server.mario.environment import InfiniteMario
from glue.errors import ConfigError, SaveError
from glue.options import parameters
from glue.roles import Agent, capabilities
from glue.saves import Saved, pack
from glue.testing import check_agent
from glue.types import Action, Observation
from tests.agents.topologies import check_same_over_sockets

if TYPE_CHECKING:
    from tests.agents.conftest import Learned

LEARNERS: list[type[MarioLearner]] = [
    TilesAgent,
    TilesCoarseAgent,
    ObjectsFlatAgent,
    HierarchicalProgrammedAgent,
    HierarchicalAgent,
    HierarchicalFactsAgent,
    HierarchicalInternalAgent,
    ObjectsCoarseAgent,
]
ALL: list[type[Any]] = [*LEARNERS, SampleAgent]

every_agent = pytest.mark.parametrize("kind", ALL, ids=lambda kind: kind.name)
every_learner = pytest.mark.parametrize("kind", LEARNERS, ids=lambda kind: kind.name)


def short_level() -> InfiniteMario:
    """Return an initialised level: 60 columns, a few Goombas and coins, and a limit of 150 steps."""
    environment = InfiniteMario(level_seed=7, level_width=60, max_trial_steps=150)
    environment.env_init()
    return environment


def play(agent: Agent, environment: InfiniteMario, episodes: int) -> tuple[list[Action], list[float]]:
    """Play with an initialised agent; return every action and every episode's return."""
    actions, returns = [], []
    for _ in range(episodes):
        total, terminal = 0.0, False
        action = agent.agent_start(environment.env_start())
        while not terminal:
            actions.append(action)
            reward, observation, terminal, *_ = environment.env_step(action)
            total += reward
            if not terminal:
                action = agent.agent_step(reward, observation)
        agent.agent_end(reward)
        returns.append(total)
    return actions, returns


def trained(kind: type[Any], seed: int, episodes: int, **options: Any) -> tuple[Any, InfiniteMario]:
    agent, environment = kind(**options), short_level()
    agent.agent_seed(seed)
    agent.agent_init(environment.env_init())
    play(agent, environment, episodes)
    return agent, environment


@every_agent
@pytest.mark.parametrize(
    "task_spec",
    [
        "VERSION RL-Glue-3.0 PROBLEMTYPE episodic DISCOUNTFACTOR 1 OBSERVATIONS INTS (0 20) "
        "ACTIONS INTS (0 1) REWARDS (-1 1) EXTRA Mario-v1",
        "Mario-v1",
        "",
        "no task spec at all " * 50,
    ],
)
def test_another_task_is_refused_in_words(kind: type[Any], task_spec: str) -> None:
    with pytest.raises(ConfigError, match=f"agent {kind.name} plays Infinite Mario") as refusal:
        kind().agent_init(task_spec)
    assert len(str(refusal.value)) < 300


@every_agent
def test_agents_can_be_seeded_and_saved(kind: type[Any]) -> None:
    assert {"save", "seed"} <= set(capabilities(kind()))


@every_learner
def test_learners_report_metrics(kind: type[Any]) -> None:
    assert "metrics" in capabilities(kind())


@every_learner
def test_the_papers_values_are_the_defaults(kind: type[Any]) -> None:
    options = parameters(kind)
    paper = {"step_size": 0.3, "discount": 0.9, "epsilon": 0.1, "reduction": 0.9999, "learning": True}
    assert {name: options[name].default for name in paper} == paper
    assert all(parameter.option.help for parameter in options.values())


@every_agent
def test_the_same_seed_gives_the_same_actions(kind: type[Any]) -> None:
    def actions(experiments_seed: int, own_seed: int | None = None) -> list[Action]:
        agent, environment = kind(seed=own_seed), short_level()
        agent.agent_seed(experiments_seed)
        agent.agent_init(environment.env_init())
        return play(agent, environment, 5)[0]

    assert actions(3) == actions(3)
    assert actions(3) != actions(4)
    assert actions(4, own_seed=3) == actions(3)


@every_agent
def test_init_forgets_everything(kind: type[Any]) -> None:
    agent, environment = trained(kind, 1, 5)
    agent.agent_cleanup()
    agent.agent_init(environment.env_init())
    again = play(agent, short_level(), 5)[0]
    fresh = kind()
    fresh.agent_seed(1)
    fresh.agent_init(environment.env_init())
    assert again == play(fresh, short_level(), 5)[0]


@every_agent
def test_an_agent_loaded_goes_on_as_the_one_that_was_saved(kind: type[Any]) -> None:
    agent, environment = trained(kind, 1, 30)
    saved = agent.agent_save()
    other = kind()
    other.agent_seed(2)
    other.agent_init(environment.env_init())
    play(other, short_level(), 3)
    other.agent_load(saved)
    assert other.agent_save() == saved
    twin = short_level()
    twin.env_load(environment.env_save())
    assert play(other, twin, 30) == play(agent, environment, 30)
    assert other.agent_save() == agent.agent_save()


@every_learner
def test_a_trained_agent_can_be_watched_without_learning(kind: type[Any], learned: Learned) -> None:
    agent, _ = trained(kind, 1, 30)
    saved = agent.agent_save()
    watched = kind(learning=False, epsilon=0.0)
    watched.agent_init(short_level().env_init())
    watched.agent_load(saved)
    assert watched.agent_message("epsilon") == "0.0"
    play(watched, short_level(), 3)
    assert learned(watched) == learned(agent)


def test_values_of_other_options_are_not_loaded(task_spec: str) -> None:
    saved = trained(HierarchicalAgent, 1, 2)[0].agent_save()
    agent = HierarchicalAgent(grid=4)
    agent.agent_init(task_spec)
    with pytest.raises(SaveError, match="saved with the options grid=2, tile_above=False"):
        agent.agent_load(saved)
    other = HierarchicalProgrammedAgent()
    other.agent_init(task_spec)
    with pytest.raises(SaveError, match="saved by 'hierarchical', and"):
        other.agent_load(saved)


KEYS, VALUES = np.array([1, 5], np.uint64), np.array([0.5, -1.0])


@pytest.mark.parametrize(
    ("numbers", "arrays"),
    [
        ({"random": 1, "cycles": 0}, {"keys": KEYS}),
        ({"random": 1, "cycles": 0}, {"values": VALUES}),
        ({"random": 1, "cycles": 0}, {"keys": KEYS[::-1], "values": VALUES}),
        ({"random": 1, "cycles": 0}, {"keys": KEYS - np.uint64(1), "values": VALUES}),
        ({"random": 1, "cycles": 0}, {"keys": np.array([5, 5], np.uint64), "values": VALUES}),
        ({"random": 1, "cycles": 0}, {"keys": KEYS, "values": VALUES[:1]}),
        ({"random": 1, "cycles": 0}, {"keys": KEYS.astype(np.int64), "values": VALUES}),
        ({"random": 1, "cycles": 0}, {"keys": KEYS, "values": np.array([0.5, np.nan])}),
        ({"random": -1, "cycles": 0}, {"keys": KEYS, "values": VALUES}),
        ({"random": 2**64, "cycles": 0}, {"keys": KEYS, "values": VALUES}),
        ({"random": 1, "cycles": -1}, {"keys": KEYS, "values": VALUES}),
        ({"cycles": 0}, {"keys": KEYS, "values": VALUES}),
    ],
)
def test_what_a_learner_cannot_have_saved_is_refused(
    task_spec: str, numbers: dict[str, int], arrays: dict[str, Any]
) -> None:
    agent = TilesAgent()
    agent.agent_init(task_spec)
    before = agent.agent_save()
    with pytest.raises(SaveError):
        agent.agent_load(pack(Saved("tiles", {}, numbers, arrays)))
    assert agent.agent_save() == before


@pytest.mark.parametrize(
    ("numbers", "last"),
    [
        ({"random": 1, "hesitating": 0}, np.array([12], np.int8)),
        ({"random": 1, "hesitating": 0}, np.array([-1], np.int8)),
        ({"random": 1, "hesitating": 2}, np.array([1], np.int8)),
        ({"random": 2**48, "hesitating": 0}, np.array([1], np.int8)),
        ({"hesitating": 0}, np.array([1], np.int8)),
    ],
)
def test_what_the_sample_agent_cannot_have_saved_is_refused(
    task_spec: str, numbers: dict[str, int], last: Any
) -> None:
    agent = SampleAgent()
    agent.agent_init(task_spec)
    with pytest.raises(SaveError):
        agent.agent_load(pack(Saved("sample", {}, numbers, {"last": last})))


@pytest.mark.parametrize("kind", LEARNERS, ids=lambda kind: kind.name)
def test_every_learner_improves_on_a_short_level(kind: type[Any]) -> None:
    """The mean return of the last 60 episodes exceeds that of the first by more than 10, over three seeds.

    The flat agents follow the textbook here; as published, they lose the reward for dying.
    """
    gains = []
    for seed in range(3):
        agent = kind(seed=seed, terminal_update=True) if issubclass(kind, TilesAgent) else kind(seed=seed)
        environment = short_level()
        agent.agent_init(environment.env_init())
        returns = np.array(play(agent, environment, 400)[1])
        gains.append(returns[-60:].mean() - returns[:60].mean())
    assert np.mean(gains) > 10.0


def test_the_sample_agent_keeps_a_solution_once_found() -> None:
    environment = InfiniteMario()
    agent = SampleAgent(seed=0)
    agent.agent_init(environment.env_init())
    returns = play(agent, environment, 60)[1]
    assert min(returns[30:]) > 100.0


def screen(generator: np.random.Generator) -> Observation:
    """Return a random screen: any tiles, and up to three sprites around Mario."""
    count = int(generator.integers(4))
    ints = [int(generator.integers(300))]
    doubles: list[float] = []
    for kind in (int(generator.choice([0, 10, 11])), *generator.integers(1, 10, count).tolist()):
        ints += [kind, int(generator.integers(2))]
        doubles += [ints[0] + generator.uniform(0, 21), generator.uniform(-1, 17), *generator.normal(size=2)]
    tiles = generator.choice([*b"          $?7|1b!"], (16, 21)).astype(np.uint8)
    chars = b"".join(bytes(row) + b"\n" for row in tiles)
    return Observation(ints, doubles, chars)


@every_agent
def test_agents_keep_the_contract(kind: type[Any], task_spec: str) -> None:
    check_agent(kind, task_spec, observation=screen)


def test_over_sockets_an_agent_acts_as_in_one_process() -> None:
    check_same_over_sockets(HierarchicalAgent, short_level)
