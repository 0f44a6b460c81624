"""The agent `best`: on a walk that can be computed by hand, and on Mario's levels."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import pytest

from agents.mario.agent import ACTIONS, LEFT, action_number
from agents.mario.best import BestAgent
from env_server.mario.environment import InfiniteMario
from glue import Action, Environment, Observation, local
from glue.saves import unpack
from tests.agents.screens import TASK_SPEC, draw

RUN_LEFT = ACTIONS[action_number(LEFT, False, True)]


@dataclass
class Walk(Environment):
    """A walk that looks like Mario: one tile per step, pits to jump over, and coins taken only by jumping.

    The rewards are Mario's: +100 at the goal, -10 for a pit or at the step limit, +1 for a coin, and
    -0.01 per step. If `pushed`, the last direction of an episode shifts the start of the next, as in Mario.
    """

    goal: int = 25
    pits: tuple[int, ...] = (9, 15)
    coins: tuple[int, ...] = (6, 20, 21)
    pushed: bool = True
    max_steps: int = 60
    x: int = field(default=0, init=False)
    direction: int = field(default=0, init=False)

    def env_init(self) -> str:
        self.direction = 0
        return TASK_SPEC

    def env_start(self) -> Observation:
        self.x = 2 + self.direction * self.pushed
        self.steps = 0
        self.taken: set[int] = set()
        return self._see()

    def env_step(self, action: Action) -> tuple[float, Observation, bool]:
        self.direction, jump, _ = action.ints.tolist()
        self.x = max(0, self.x + self.direction)
        self.steps += 1
        if self.x == self.goal:
            return 100.0, self._see(), True
        if (self.x in self.pits and not jump) or self.steps == self.max_steps:
            return -10.0, self._see(), True
        coin = self.x in self.coins and bool(jump) and self.x not in self.taken
        self.taken |= {self.x} if coin else set()
        return coin - 0.01, self._see(), False

    def _see(self) -> Observation:
        return Observation([0, 0, 0], [self.x + 0.5, 2.0, 0.0, 0.0], b" " * 352)


def play(agent: BestAgent, environment: Environment, episodes: int) -> tuple[list[list[Action]], list[float]]:
    """Play with an initialised agent; return every episode's actions and return."""
    actions, returns = [], []
    glue = local(agent, environment)
    for _ in range(episodes):
        actions.append([glue.rl_start().action])
        while not (step := glue.rl_step()).terminal:
            actions[-1].append(step.action)
        returns.append(glue.rl_return())
    return actions, returns


def started(environment: Environment, seed: int = 1, **options: Any) -> BestAgent:
    """Return an initialised agent."""
    agent = BestAgent(seed=seed, **options)
    agent.agent_init(environment.env_init())
    return agent


def short_level(difficulty: int = 0) -> InfiniteMario:
    return InfiniteMario(level_seed=7, level_width=60, max_trial_steps=300, level_difficulty=difficulty)


def memory(agent: BestAgent) -> dict[str, bytes]:
    """Return an agent's memory of its worlds, as bytes by name."""
    arrays = unpack(agent.agent_save(), "best", {}).arrays
    return {name: array.tobytes() for name, array in arrays.items() if name != "generator"}


def worlds(agent: BestAgent) -> int:
    """Return how many worlds an agent remembers."""
    return len(unpack(agent.agent_save(), "best", {}).arrays["worlds"])


def greatest_return(walk: Walk) -> float:
    """Return the return of a perfect episode: four steps to settle at the edge, then a jump at every tile."""
    return 100.0 + len(walk.coins) - 0.01 * (4 + walk.goal - 1)


@pytest.mark.parametrize("seed", range(5))
def test_the_best_way_of_a_walk_is_found_and_then_repeated(seed: int) -> None:
    walk = Walk()
    agent = started(walk, seed, horizon=600)
    actions, returns = play(agent, walk, 700)
    assert max(returns) == pytest.approx(greatest_return(walk))
    assert returns[600:] == [max(returns)] * 100
    assert all(each == actions[-1] for each in actions[600:])
    assert agent.agent_message("best") == repr(max(returns))


def test_every_episode_settles_at_the_edge_so_that_there_is_one_world() -> None:
    walk = Walk()
    agent = started(walk)
    actions, _ = play(agent, walk, 50)
    assert all(each[:4] == [RUN_LEFT] * 4 for each in actions)
    assert len({each[4] for each in actions}) > 1
    assert worlds(agent) == 1


def test_worlds_that_begin_differently_are_remembered_apart() -> None:
    """A walk that begins far from the edge: the end of one episode decides the start of the next."""

    class FarWalk(Walk):
        def env_start(self) -> Observation:
            observation = super().env_start()
            self.x += 8 * self.pushed
            return observation if not self.pushed else self._see()

    walk = FarWalk(pits=(16,), coins=(18,))
    agent = started(walk, horizon=800)
    _, returns = play(agent, walk, 900)
    assert worlds(agent) > 1
    assert min(returns[-100:]) > 100.0


def test_more_worlds_than_can_be_kept_are_not_kept() -> None:
    agent = started(Walk())
    for x in range(40):
        screen = draw("7" * 21, at=(float(x), 2.0))
        agent.agent_start(screen)
        for _ in range(8):
            agent.agent_step(-0.01, screen)
        agent.agent_end(-10.0)
    assert worlds(agent) == 8


def test_when_the_world_changes_the_agent_begins_anew() -> None:
    walk = Walk()
    agent = started(walk, horizon=400)
    _, returns = play(agent, walk, 450)
    assert returns[-1] == pytest.approx(greatest_return(walk))
    other = replace(walk, goal=12, pits=(5, 6, 10), coins=(4,))
    _, returns = play(agent, other, 450)
    assert returns[-50:] == pytest.approx([greatest_return(other)] * 50)


def test_an_episode_explores_less_and_less_and_never_after_the_horizon() -> None:
    walk = Walk()
    agent = started(walk, horizon=10)
    chances = []
    for _ in range(12):
        chances.append(float(agent.agent_message("epsilon")))
        play(agent, walk, 1)
    assert chances == pytest.approx([*(1 - (n / 10) ** 3 for n in range(10)), 0.0, 0.0])
    assert float(started(walk, epsilon=0.5).agent_message("epsilon")) == 0.5


def test_without_exploring_the_first_episode_is_repeated() -> None:
    walk = Walk(pushed=False)
    actions, _ = play(started(walk, epsilon=0.0), walk, 20)
    assert actions == [actions[0]] * 20


def test_an_episode_that_was_cut_off_leaves_its_places() -> None:
    walk = Walk()
    agent = started(walk)
    local(agent, walk).rl_episode(9)
    assert agent.agent_message("best") == "none"
    assert int(agent.agent_message("cells")) > 0
    _, returns = play(agent, walk, 1)
    assert agent.agent_message("best") == repr(returns[0])


def test_an_episode_that_ends_while_settling_teaches_nothing() -> None:
    agent = started(Walk())
    for _ in range(3):
        agent.agent_start(draw("M"))
        agent.agent_step(-0.01, draw("M"))
        agent.agent_end(-10.0)
    assert agent.agent_message("best") == "none"


def test_an_endless_episode_takes_no_more_than_so_much_memory() -> None:
    agent = started(Walk())
    screen = draw("M", "7" * 21)
    agent.agent_start(screen)
    for _ in range(5000):
        agent.agent_step(1.0, screen)
    agent.agent_end(1.0)
    assert agent.agent_message("best") == "none"
    assert len(agent.agent_save()) < 10_000


@pytest.mark.parametrize("difficulty", [0, 3])
def test_a_short_level_is_finished_better_and_better(difficulty: int) -> None:
    environment = short_level(difficulty)
    _, returns = play(started(environment, horizon=400), environment, 420)
    assert returns[-20:] == [max(returns)] * 20
    assert max(returns) > 100.0
    assert max(returns) > max(returns[:20])


def test_without_learning_the_best_episode_is_repeated_and_nothing_changes() -> None:
    environment = short_level()
    agent = started(environment)
    _, returns = play(agent, environment, 100)
    watched = started(environment, learning=False)
    watched.agent_load(agent.agent_save())
    assert play(watched, environment, 5)[1] == [max(returns)] * 5
    other = short_level(3)
    other.env_init()
    play(watched, other, 5)
    environment.env_init()
    assert play(watched, environment, 1)[1] == [max(returns)]
    assert memory(watched) == memory(agent)


def test_messages_are_answered() -> None:
    agent = started(Walk())
    assert [agent.agent_message(each) for each in ("best", "cells", "epsilon")] == ["none", "0", "1.0"]
    assert "answers only the messages best, cells and epsilon" in agent.agent_message("hello")
