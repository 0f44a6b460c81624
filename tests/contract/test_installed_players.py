"""Every installed agent and environment keeps the contract; new entry points are covered automatically."""

from __future__ import annotations

from functools import cache, partial
from typing import Any

import numpy as np
import pytest

from glue.engine.local import local
from glue.errors import ConfigError, GlueError
from glue.options import parameters
from glue.plugins.loading import find
from glue.taskspec import parse_task_spec
from glue.testing import check_agent, check_environment
from glue.types import Action, Observation
from glue.wire.messages import Role
from tests.players import installed

AGENTS = installed(Role.AGENT)
ENVIRONMENTS = installed(Role.ENVIRONMENT)
STEPS = {"planner-learns": 6}
"""Steps of an episode, for agents that take long to decide."""

OTHER_TASKS = [
    "VERSION RL-Glue-3.0 PROBLEMTYPE episodic DISCOUNTFACTOR 1 OBSERVATIONS INTS (0 20) "
    "ACTIONS INTS (0 1) REWARDS (-1 1) EXTRA Mario-v1",
    "Mario-v1",
    "",
    "no task spec at all " * 50,
]


@cache
def observations(environment: str) -> list[Observation]:
    """Return the observations of 100 steps of random actions."""
    player: Any = find(Role.ENVIRONMENT, environment)()
    actions = parse_task_spec(player.env_init()).actions
    generator = np.random.default_rng(5)
    seen = [player.env_start()]
    for _ in range(100):
        _, observation, terminal, *_ = player.env_step(Action(*actions.sample(generator)))
        seen.append(player.env_start() if terminal else observation)
    return seen


def observe(environment: str, generator: np.random.Generator) -> Observation:
    seen = observations(environment)
    return seen[int(generator.integers(len(seen)))]


def can_play(agent: str, environment: str) -> bool:
    """Return whether an agent accepts a task, by playing its first steps."""
    players: tuple[Any, Any] = find(Role.AGENT, agent)(), find(Role.ENVIRONMENT, environment)()
    try:
        with local(*players) as glue:
            glue.rl_init(seed=1)
            glue.rl_episode(5)
    except GlueError:
        return False
    return True


@pytest.mark.parametrize("role", [Role.AGENT, Role.ENVIRONMENT])
def test_every_option_is_explained(role: Role) -> None:
    for name in installed(role):
        for option in parameters(find(role, name)).values():
            assert option.option.help, f"{name}: {option}"


@pytest.mark.parametrize("name", ["best", "hierarchical", "planner", "sample", "tiles"])
def test_another_task_is_refused_in_words(name: str) -> None:
    for task_spec in OTHER_TASKS:
        agent: Any = find(Role.AGENT, name)()
        with pytest.raises(ConfigError, match=f"agent {name} plays Infinite Mario") as refusal:
            agent.agent_init(task_spec)
        assert len(str(refusal.value)) < 300


@pytest.mark.parametrize("name", ENVIRONMENTS)
def test_environment_keeps_the_contract(name: str) -> None:
    check_environment(find(Role.ENVIRONMENT, name), episodes=2, steps=100)


@pytest.mark.parametrize("name", AGENTS)
def test_agent_keeps_the_contract_in_every_task_that_it_can_play(name: str) -> None:
    tasks = [environment for environment in ENVIRONMENTS if can_play(name, environment)]
    assert tasks, f"{name} plays none of {ENVIRONMENTS}"
    for environment in tasks:
        player: Any = find(Role.ENVIRONMENT, environment)()
        check_agent(
            find(Role.AGENT, name),
            player.env_init(),
            observation=partial(observe, environment),
            episodes=2,
            steps=STEPS.get(name, 12),
        )


@pytest.mark.parametrize(
    ("agent", "tasks"), [("random", {"mario", "mines", "skeleton"}), ("sarsa", {"mines", "skeleton"})]
)
def test_agents_play_the_tasks_that_they_are_made_for(agent: str, tasks: set[str]) -> None:
    assert tasks <= {environment for environment in ENVIRONMENTS if can_play(agent, environment)}
