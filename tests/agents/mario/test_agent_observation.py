"""Observations of Infinite Mario: which are read, and which are refused."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache
from typing import cast

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from agents.mario.best import BestAgent
from agents.mario.observation import CHARS, MAX_SPRITES, Screen, read
from agents.mario.sample import SampleAgent
from agents.mohan2010.hierarchical import HierarchicalAgent
from glue import Agent, Observation, RemoteProtocolError
from glue.compiled.records import new
from tests.agents.screens import TASK_SPEC, draw


def screen_of(observation: Observation) -> Screen | None:
    screens = new(Screen)
    if not read(observation.body, cast(Screen, screens[0])):
        return None
    return cast(Screen, screens.view(np.recarray)[0])


def test_mario_is_kept_apart_from_the_other_sprites() -> None:
    monsters = [(3, 5.25, 1.5, -0.5, 0.25), (9, 6.0, 2.0, 1.0, -1.0)]
    screen = screen_of(draw("M", monsters=monsters, mario=11, at=(0.5, 0.75), speed=(0.125, -2.0)))
    assert screen is not None
    mario = screen.mario
    assert (mario.kind, mario.x, mario.y, mario.speed_x, mario.speed_y) == (11, 0.5, 0.75, 0.125, -2.0)
    assert screen.count == 2
    seen = [(s.kind, s.x, s.y, s.speed_x, s.speed_y) for s in screen.sprites[:2]]
    assert seen == monsters


def test_as_many_sprites_as_there_is_room_for_are_read() -> None:
    def crowd(sprites: int) -> Observation:
        return Observation([0] * (1 + 2 * sprites), [1.0] * (4 * sprites), b" " * CHARS)

    full = screen_of(crowd(MAX_SPRITES))
    assert full is not None
    assert full.count == MAX_SPRITES - 1
    assert screen_of(crowd(MAX_SPRITES + 1)) is None
    assert screen_of(crowd(0)) is None


@given(ints=st.integers(0, 9), doubles=st.integers(0, 17), chars=st.integers(CHARS - 1, CHARS + 1))
def test_only_marios_layout_is_read(ints: int, doubles: int, chars: int) -> None:
    observation = Observation([0] * ints, [1.0] * doubles, b" " * chars)
    fits = ints % 2 == 1 and ints >= 3 and doubles == 2 * (ints - 1) and chars == CHARS
    assert (screen_of(observation) is not None) is fits


@pytest.mark.parametrize("number", [math.nan, math.inf, -math.inf, 2.0**31])
@pytest.mark.parametrize("place", [0, 1, 2, 3, 4, 7])
def test_places_and_speeds_must_be_finite_and_near(number: float, place: int) -> None:
    good = draw("M", monsters=[(3, 1.0, 1.0, 0.0, 0.0)])
    doubles = good.doubles.tolist()
    doubles[place] = number
    assert screen_of(Observation(good.ints, doubles, good.chars)) is None


@cache
def agents() -> list[Agent]:
    """Return initialised agents, since an init costs as much as many observations."""
    made: list[Agent] = [HierarchicalAgent(), SampleAgent()]
    for agent in made:
        agent.agent_init(TASK_SPEC)
    return made


@given(
    ints=st.lists(st.integers(-(2**31), 2**31 - 1), min_size=5, max_size=5),
    doubles=st.lists(st.floats(), min_size=8, max_size=8),
    chars=st.binary(min_size=CHARS, max_size=CHARS),
)
def test_whatever_fills_the_layout_an_agent_acts_or_refuses(
    ints: list[int], doubles: list[float], chars: bytes
) -> None:
    observation = Observation(ints, doubles, chars)
    for agent in agents():
        try:
            assert agent.agent_start(observation).counts == (3, 0, 0)
        except RemoteProtocolError:
            assert not all(abs(number) < 2.0**31 for number in doubles)


@pytest.mark.parametrize("kind", [BestAgent, HierarchicalAgent, SampleAgent])
def test_an_observation_of_another_task_is_refused_with_what_came(kind: Callable[[], Agent]) -> None:
    agent = kind()
    agent.agent_init(TASK_SPEC)
    with pytest.raises(RemoteProtocolError, match="1 ints, 0 doubles and 0 chars"):
        agent.agent_start(Observation([7]))
