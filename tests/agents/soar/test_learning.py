"""The values that Soar's reinforcement learning learns in a game, each checked: SARSA at both levels."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import pytest

from agents.soar.agents import (
    SoarFlatAgent,
    SoarHierarchicalAgent,
    SoarHierarchicalInternalAgent,
    parse_rules,
)
from env_server.mario.environment import InfiniteMario
from glue import local, make_agent
from studies.soar_values import CONTEXT, KEYSTROKE, OPERATOR, Learned, learned_values
from tests.agents.soar.memory import Memory, working_memory

pytest.importorskip("soar_sml", reason="agents on the Soar kernel need it: pip install 'glue-rl[soar]'")

STEP_SIZE, DISCOUNT = 0.3, 0.9
Keys = Sequence[Learned]


class Textbook:
    """SARSA on the sum of values; the last operator of the top state learns only from the next one."""

    def __init__(self) -> None:
        self.values: dict[Learned, float] = defaultdict(float)

    def value(self, keys: Keys) -> float:
        return sum(self.values[key] for key in keys)

    def update(self, keys: Keys, target: float) -> None:
        error = target - self.value(keys)
        for key in keys:
            self.values[key] += STEP_SIZE / len(keys) * error


class Watched:
    """An agent's choices, read from its working memory after a step; with `goals`, objects too."""

    def __init__(self, agent: Any, goals: bool = False) -> None:
        kernel = agent._kernel
        stack = kernel.command("print --stack")
        selected = re.findall(r" O: (\w+) ", stack)
        self.flo = selected[0]
        top = working_memory(kernel, selected[0], 1)[selected[0]]
        keystroke = working_memory(kernel, selected[-1], 1)[selected[-1]]
        self.flo_name = top["name"][0]
        self.flo_keys: Keys = [
            *(Learned(OPERATOR, text, "") for text in top.get("sees", [])),
            *(Learned(CONTEXT, text, self.flo_name) for text in top.get("context", [])),
        ]
        name = keystroke["keystroke"][0]
        self.keystroke_keys: Keys = [Learned(KEYSTROKE, text, name) for text in keystroke.get("sees", [])]
        if goals:
            self.memory = working_memory(kernel, "i2", 5)
            thing = top.get("object", [""])[0]
            self.object: Mapping[str, list[str]] = self.memory.get(thing, {})
            self.object_place = place(self.memory, thing)


def place(memory: Memory, tile: str) -> tuple[str, str] | None:
    """Return the column and the row of a tile, or None if it is not in view."""
    for column in memory["I2"]["column"]:
        if tile in memory[column].get("tile", []):
            return memory[column]["number"][0], memory[tile]["row"][0]
    return None


def goal_reached(before: Watched, now: Memory) -> bool:
    """Return whether the object of an FLO is gone, or is a monster more than three tiles behind."""
    if before.flo_name == "tackle-monster":
        monsters = {now[monster]["id"][0]: now[monster] for monster in now["I2"]["monster"]}
        left = monsters.get(before.object["id"][0])
        return left is None or int(left["dx"][0]) < -6
    assert before.object_place is not None
    number, row = before.object_place
    columns = {now[column]["number"][0]: now[column] for column in now["I2"]["column"]}
    if number not in columns:
        return False
    there = [now[tile]["type"] for tile in columns[number].get("tile", []) if now[tile]["row"] == [row]]
    return there != [before.object["type"]]


def choices(agent: Any, episodes: int) -> Iterator[tuple[float, bool]]:
    """Play; yield the reward before each choice, once the agent has made it, and the last one with True."""
    glue = local(agent, InfiniteMario())
    glue.rl_init(seed=2)
    for _ in range(episodes):
        glue.rl_start()
        reward, terminal = 0.0, False
        while not terminal:
            yield reward, False
            reward, _, terminal, *_ = glue.rl_step()
        yield reward, True


def follow(agent: Any, episodes: int, saves: bool = False) -> Textbook:
    """Learn from the agent's choices as it does; with `saves`, save the agent after each episode.

    A saved agent continues in a new kernel, from the save.
    """
    internal = isinstance(agent, SoarHierarchicalInternalAgent)
    book = Textbook()
    before: Watched | None = None
    klo: Keys = ()
    flo: Keys = ()
    total, weight = 0.0, 1.0
    for reward, terminal in choices(agent, episodes):
        if terminal:
            if klo:
                book.update(klo, -0.01 - 10 * (reward < 0) if internal else reward)
            if saves:
                agent.agent_save()
            before, klo, flo, total, weight = None, (), (), 0.0, 1.0
            continue
        now = Watched(agent, internal)
        total += weight * reward
        if before is not None and now.flo == before.flo:
            earned = -0.01 if internal else reward
            book.update(klo, earned + DISCOUNT * book.value(now.keystroke_keys))
        else:
            if before is not None and klo:
                earned = -0.01 + goal_reached(before, now.memory) if internal else reward
                book.update(klo, earned)
            if now.flo_keys:
                book.update(flo, total + weight * DISCOUNT * book.value(now.flo_keys))
                flo, total, weight = now.flo_keys, 0.0, 1.0
            else:
                weight *= DISCOUNT
        klo = now.keystroke_keys
        before = now
    return book


def flat(agent: Any, episodes: int) -> Textbook:
    """Do the same as `follow` for the flat agent, which has one level, and loses its last reward."""
    book = Textbook()
    last: Keys = ()
    for reward, terminal in choices(agent, episodes):
        if terminal:
            last = ()
            continue
        now = Watched(agent).keystroke_keys
        book.update(last, reward + DISCOUNT * book.value(now))
        last = now
    return book


def check(agent: Any, book: Textbook, within: float = 2e-6) -> None:
    found = learned_values(parse_rules(agent._kernel.value_rules()))
    agent.agent_cleanup()
    expected = {key: book.value([key]) for key in found}
    assert len([value for value in expected.values() if value]) > 50
    assert book.values.keys() == found.keys()
    assert found == pytest.approx(expected, abs=within)


@pytest.mark.parametrize("saves", [False, True])
@pytest.mark.parametrize(
    "name",
    [
        *("hierarchical-programmed", "hierarchical", "hierarchical-facts", "hierarchical-internal"),
        "objects-coarse",
    ],
)
def test_both_levels_learn_what_the_textbook_says_also_if_saved_after_every_episode(
    name: str, saves: bool
) -> None:
    agent = make_agent(f"soar-{name}")
    check(agent, follow(agent, 4, saves), within=1e-4 if saves else 2e-6)


def test_a_cut_off_episode_teaches_nothing_more() -> None:
    agent: Any = SoarHierarchicalAgent()
    game = InfiniteMario()
    agent.agent_init(game.env_init())
    action = agent.agent_start(game.env_start())
    while not Watched(agent).keystroke_keys:
        reward, observation, *_ = game.env_step(action)
        action = agent.agent_step(reward, observation)
    agent.agent_step(-5.0, observation)
    learned = parse_rules(agent._kernel.value_rules())
    agent.agent_start(game.env_start())
    assert set(learned) <= set(parse_rules(agent._kernel.value_rules()))
    agent.agent_cleanup()


def test_the_flat_agent_learns_what_the_textbook_says_but_for_the_last_reward() -> None:
    agent = SoarFlatAgent()
    check(agent, flat(agent, 3))
