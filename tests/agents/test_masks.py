"""Agents choose legal actions, and without a mask do what they did before there were masks."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from agents.baselines import RandomAgent
from agents.linear import LinearAgent
from agents.mario.agent import ACTIONS, legal_actions
from agents.network.agent import NetworkAgent
from agents.tabular import SarsaAgent, epsilon_greedy
from env_server.toys import MinesEnvironment
from glue import Action, Agent, Observation, RemoteProtocolError, local
from glue.roles import capabilities
from glue.taskspec import legal_values, parse_task_spec
from glue.taskspec.spaces import Box, Discrete, Tuple, task_spec
from tests.agents.screens import draw
from tests.players import returns

DIGITS = task_spec(Discrete(10), Discrete(10, start=-3), extra="masks")


def masks(seed: int, bits: int) -> Iterator[list[bool]]:
    """Yield masks of a single int, each with a legal value."""
    generator = np.random.default_rng(seed)
    while True:
        mask = generator.random(bits) < 0.3
        if mask.any():
            yield mask.tolist()


@pytest.mark.parametrize("agent", [SarsaAgent(epsilon=0.5), LinearAgent(epsilon=0.5), RandomAgent()])
def test_every_legal_action_is_taken_and_no_other(agent: Agent) -> None:
    agent.agent_seed(1)  # type: ignore[attr-defined]
    agent.agent_init(DIGITS)
    given = masks(2, 10)
    action = agent.agent_start(Observation([0], mask=next(given)))
    taken = set()
    for step in range(600):
        mask = next(given)
        action = agent.agent_step(-float(action.ints[0]), Observation([step % 10], mask=mask))
        choice = int(action.ints[0]) + 3
        assert mask[choice]
        taken.add(choice)
    assert taken == set(range(10))
    assert "mask" in capabilities(agent)


@pytest.mark.parametrize("make", [SarsaAgent, LinearAgent, RandomAgent])
def test_a_mask_that_allows_everything_changes_nothing_that_is_learned(make: Any) -> None:
    """The draws of `random` differ: with a mask it draws among the legal values, one int after the other."""
    found = []
    for mask in (None, [True] * 10):
        agent = make(seed=5)
        agent.agent_init(DIGITS)
        actions = [agent.agent_start(Observation([0], mask=mask))]
        for step in range(300):
            actions.append(agent.agent_step(float(step % 7), Observation([step % 10], mask=mask)))
        found.append(actions)
    assert (found[0] == found[1]) == (make is not RandomAgent)


@pytest.mark.parametrize(
    ("agent", "total", "saved"),
    [(LinearAgent(epsilon=0.2), -2040.0, "e797b2cc1b38aab6"), (RandomAgent(), -2173.0, "b31c79036d7c34ee")],
)
def test_without_masks_agents_do_what_they_did_before_there_were_any(
    agent: Agent, total: float, saved: str
) -> None:
    with local(agent, MinesEnvironment(random_start=True)) as glue:
        glue.rl_init(seed=1)
        assert sum(returns(glue, 20, 200)) == total
        assert hashlib.sha256(glue.rl_agent_save()).hexdigest().startswith(saved)


def test_in_mines_with_masks_a_move_is_legal_if_it_leads_into_no_wall() -> None:
    mines = MinesEnvironment(random_start=True, masks=True)
    assert parse_task_spec(mines.env_init()).masks
    assert capabilities(mines) == ("mask", "save", "seed", "truncate")
    moved = set()
    for _ in range(300):
        seen = mines.env_start()
        for move in range(4):
            (legal,) = legal_values(seen, (4,))
            after = mines.env_step(Action([move])).observation
            moved.add((bool(legal[move]), after.ints[0] != seen.ints[0]))
            seen = after
    assert moved == {(True, True), (False, False)}
    assert "mask" not in capabilities(MinesEnvironment())


def test_the_greedy_choice_is_the_best_legal_one_with_ties_broken_at_random() -> None:
    generator = np.random.default_rng(3)
    masked = Observation(mask=[False, True, True, False])
    assert {epsilon_greedy(generator, 0.0, [9, 1, 1, 9], masked) for _ in range(40)} == {1, 2}
    assert epsilon_greedy(generator, 0.0, [9, 1, 2, 9], masked) == 2


def test_random_actions_of_several_parts_are_even_among_the_legal_ones() -> None:
    agent = RandomAgent(seed=4)
    agent.agent_init(
        task_spec(Discrete(1), Tuple(Discrete(2), Box(0, 1), Discrete(3, start=5)), extra="masks")
    )
    mask = [True, False, True, False, True]
    actions = [agent.agent_start(Observation([0], mask=mask)) for _ in range(400)]
    assert {int(action.ints[0]) for action in actions} == {0}
    last = [int(action.ints[1]) for action in actions]
    assert set(last) == {5, 7}
    assert 150 < last.count(5) < 250
    assert len({float(action.doubles[0]) for action in actions}) == 400


def test_random_actions_with_and_without_masks_in_turn_depend_on_the_seed_alone() -> None:
    runs = []
    for saves in (False, True):
        agent, given = RandomAgent(seed=6), masks(7, 10)
        agent.agent_init(DIGITS)
        actions: list[Action] = []
        for step in range(60):
            if saves and step % 10 == 0:
                agent.agent_load(agent.agent_save())
            mask = next(given)
            actions.append(agent.agent_start(Observation([0], mask=mask if step % 3 else None)))
        runs.append(actions)
    assert runs[0] == runs[1]


@pytest.mark.parametrize("mask", [[True] * 7, [False] * 10, [True] * 17])
def test_a_mask_of_another_task_is_the_environments_mistake(mask: list[bool]) -> None:
    for agent in (SarsaAgent(), LinearAgent(), RandomAgent()):
        agent.agent_init(DIGITS)
        with pytest.raises(RemoteProtocolError, match="mask"):
            agent.agent_start(Observation([0], mask=mask))


def test_the_network_takes_its_preferred_legal_action() -> None:
    seen = draw("          M          ", "#####################")
    mask = [True, True, False, True, False, True, True]  # not to the right, no jump
    masked = Observation(seen.ints, seen.doubles, seen.chars, mask=mask)
    assert [ACTIONS[i].ints.tolist() for i in np.flatnonzero(legal_actions(masked))] == [
        [-1, 0, 0],
        [-1, 0, 1],
        [0, 0, 0],
        [0, 0, 1],
    ]
    assert legal_actions(seen).all()
    drawing, greedy = NetworkAgent(), NetworkAgent(greedy=True)
    legal = {ACTIONS[i] for i in np.flatnonzero(legal_actions(masked))}
    assert {drawing.agent_start(masked) for _ in range(60)} <= legal
    assert greedy.agent_start(seen) not in legal
    assert greedy.agent_start(masked) in legal
