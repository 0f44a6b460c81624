"""Soar's rules derive the same relations and proposals from an observation as our own agents."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from functools import partial
from typing import Any

import numpy as np
import pytest

from agents.mario.agent import ACTIONS
from agents.mario.objects import A_COIN, A_MONSTER, A_PIT, A_QUESTION, THREATS_2010, THREATS_2012, Object
from agents.soar.agents import SoarHierarchicalAgent, SoarHierarchicalFactsAgent, SoarObjectsCoarseAgent
from agents.soar.mario_link import SPRITES
from env_server.mario.environment import InfiniteMario
from glue.types import Observation
from tests.agents.screens import Watcher
from tests.agents.soar.memory import Memory, working_memory

pytest.importorskip("soar_sml", reason="agents on the Soar kernel need it: pip install 'glue-rl[soar]'")

OBSERVATIONS = 2000
MOTIONS = ("stationary", "vertical", "towards", "away", "none")
SIGNS = ("not", "right", "left")
NAMES = {A_MONSTER: "tackle-monster", A_QUESTION: "search-question", A_COIN: "grab-coin", A_PIT: "avoid-pit"}
AGENTS = (SoarHierarchicalAgent, SoarHierarchicalFactsAgent, SoarObjectsCoarseAgent)


def observations(task: dict[str, int], seed: int, count: int) -> Iterator[Observation | None]:
    """Yield observations of a game played at random, mostly to the right; None before each episode."""
    chance = np.random.default_rng(seed)
    game = InfiniteMario(**task)
    game.env_init()
    seen = 0
    while seen < count:
        yield None
        observation, terminal = game.env_start(), False
        held = 10
        while not terminal and seen < count:
            yield observation
            seen += 1
            if chance.random() < 0.3:
                held = int(chance.integers(len(ACTIONS)) if chance.random() < 0.4 else chance.integers(8, 12))
            _, observation, terminal, *_ = game.env_step(ACTIONS[held])


LEVELS = [
    {"level_seed": seed, "level_type": kind, "level_difficulty": difficulty}
    for seed, kind, difficulty in ((121, 0, 0), (121, 0, 1), (7, 0, 3), (3, 1, 2), (9, 0, 2))
]


def motion(code: int, absolute: bool) -> str:
    if not absolute:
        return MOTIONS[code]
    names_y = ("not", "up", "down")
    return f"{SIGNS[code // 3 - 1]}-{names_y[code % 3 - 1]}"


def ours(things: Sequence[Object], absolute: bool) -> tuple[Counter[Any], Counter[Any]]:
    """Return the objects related to Mario, and the proposed FLOs."""
    relations: Counter[Any] = Counter()
    proposed: Counter[Any] = Counter({("move-to-goal",): 1})
    for thing in things:
        name = NAMES[thing.kind]
        if thing.kind == A_MONSTER:
            kind = SPRITES.get(thing.type, str(thing.type))
            relations[
                "monster", kind, thing.dx, thing.dy, motion(thing.motion, absolute), bool(thing.related)
            ] += 1
            if thing.related:
                proposed[name, kind, thing.dx, thing.dy] += 1
        elif thing.kind == A_PIT:
            relations["pit", thing.id, thing.dx] += 1
            proposed[name, thing.id] += 1
        else:
            kind = "coin" if thing.kind == A_COIN else "question"
            relations[kind, thing.dx, thing.dy] += 1
            proposed[name, kind, thing.dx, thing.dy] += 1
    return relations, proposed


def soars(memory: Memory, operators: Memory) -> tuple[Counter[Any], Counter[Any]]:
    """Return the same objects and FLOs, read from Soar's working memory: its input link and its top state."""
    relations: Counter[Any] = Counter()
    link = memory["I2"]
    for monster in link["monster"]:
        its = memory[monster]
        (kind,), (moves,), dx, dy = its["type"], its["motion"], int(its["dx"][0]), int(its["dy"][0])
        relations["monster", kind, dx, dy, moves, its.get("threat") == ["yes"]] += 1
    for column in link["column"]:
        for tile in memory[column].get("tile", []):
            its = memory[tile]
            if its.get("reachable") == ["yes"]:
                relations[its["type"][0], int(its["dx"][0]), int(its["dy"][0])] += 1
        for pit in memory[column].get("pit", []):
            if memory[pit].get("dangerous") == ["yes"]:
                relations["pit", int(memory[pit]["start"][0]), int(memory[pit]["dx"][0])] += 1

    proposed: Counter[Any] = Counter()
    for operator in operators["S1"]["operator+"]:
        its = operators[operator]
        name = its["name"][0]
        if name == "move-to-goal":
            proposed[(name,)] += 1
        elif name == "avoid-pit":
            proposed[name, int(its["start"][0])] += 1
        else:
            thing = memory[its["object"][0]]
            proposed[name, thing["type"][0], int(thing["dx"][0]), int(thing["dy"][0])] += 1
    return relations, proposed


def identities(operators: Memory) -> dict[tuple[str, str], str]:
    """Return the proposed operators, by name and object."""
    found = {}
    for operator in operators["S1"]["operator+"]:
        its = operators[operator]
        found[its["name"][0], its.get("object", its.get("start", [""]))[0]] = operator
    return found


def platforms(memory: Memory) -> set[tuple[str, ...]]:
    return {(*its["start"], *its["end"], *its["lowest"]) for its in memory.values() if "start-dx" in its}


@pytest.mark.parametrize("kind", AGENTS)
@pytest.mark.parametrize("task", LEVELS, ids=lambda task: "-".join(map(str, task.values())))
def test_relations_and_proposals_are_those_of_our_own_agents(kind: type[Any], task: dict[str, int]) -> None:
    absolute = kind is SoarObjectsCoarseAgent
    watcher = Watcher(
        threats=THREATS_2012 if absolute else THREATS_2010,
        absolute_motion=absolute,
        via_platforms=kind is not SoarHierarchicalAgent,
    )
    agent = kind(seed=1)
    agent.agent_init(InfiniteMario().env_init())
    seen: Counter[str] = Counter()
    begins = True
    known: dict[tuple[str, str], str] = {}
    built: set[tuple[str, ...]] = set()
    for observation in observations(task, seed=task["level_seed"], count=OBSERVATIONS // len(LEVELS)):
        if observation is None:
            begins = True
            known = {}
            continue
        if begins:
            agent.agent_start(observation)
            begins = False
        else:
            agent.agent_step(-0.01, observation)
        expected = ours(watcher(observation), absolute)
        memory = working_memory(agent._kernel, "i2", 5)
        operators = working_memory(agent._kernel, "s1", 2)
        assert soars(memory, operators) == expected
        now = identities(operators)
        if platforms(memory) == built:
            assert {name: now[name] for name in now.keys() & known.keys()}.items() <= known.items(), (
                "an FLO that is still proposed goes on: Soar must not open it anew"
            )
        known, built = now, platforms(memory)
        seen.update(name for name, *_ in expected[1])
    agent.agent_cleanup()
    assert len(seen) > 2, "the levels must show something to compare"


def test_a_column_that_has_left_the_view_is_gone() -> None:
    agent = SoarHierarchicalAgent(seed=1)
    agent.agent_init(InfiniteMario().env_init())
    begins = True
    for observation in observations(LEVELS[0], seed=1, count=120):
        if observation is not None:
            (agent.agent_start if begins else partial(agent.agent_step, -0.01))(observation)
        begins = observation is None
    assert agent._kernel is not None
    memory = working_memory(agent._kernel, "i2", 3)
    columns = {int(memory[column]["number"][0]): memory[column] for column in memory["I2"]["column"]}
    assert min(columns) > 0
    assert [number for number in columns if "left" not in columns[number]] == [min(columns)]
    agent.agent_cleanup()
