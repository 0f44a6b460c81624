"""Screens drawn by hand, and the values that an agent has learned, by key."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final, cast

import numpy as np

from agents.mario.objects import THREATS_2010, Object, Scene, Senses, look, set_senses
from agents.mario.observation import Screen
from agents.mohan2010.learner import MarioLearner
from agents.sarsa import extend, feature
from glue.compiled.records import new
from glue.saves import unpack
from glue.types import Observation

ROWS, COLUMNS = 16, 21
TASK_SPEC: Final = (
    "VERSION Mario-v1 PROBLEMTYPE episodic DISCOUNTFACTOR 1 "
    "ACTIONS INTS (-1 1) (2 0 1)  REWARDS (-10.0 100.0)"
)
"""The task spec of Infinite Mario with its default parameters."""

Monster = tuple[int, float, float, float, float]
"""A sprite's kind, x, y, and two speeds."""


def draw(
    *rows: str,
    monsters: Sequence[Monster] = (),
    camera: int = 0,
    mario: int = 0,
    at: tuple[float, float] | None = None,
    speed: tuple[float, float] = (0.0, 0.0),
) -> Observation:
    """Return a screen: its lowest rows from top to bottom, M for Mario; the rest is blank.

    Mario stands in the middle of his tile, a sixteenth above its floor, unless `at` gives his position.
    """
    screen = [" " * COLUMNS] * (ROWS - len(rows)) + [row.ljust(COLUMNS) for row in rows]
    chars = "".join(row + "\n" for row in screen)
    if at is None:
        place = chars.index("M")
        at = (camera + place % (COLUMNS + 1) + 0.5, ROWS - 1 - place // (COLUMNS + 1) + 0.0625)
    sprites = [(mario, *at, *speed), *monsters]
    ints = [camera, *(number for sprite in sprites for number in (sprite[0], 0))]
    doubles = [number for sprite in sprites for number in sprite[1:]]
    return Observation(ints, doubles, chars.encode("latin-1"))


class Watcher:
    """Sees screens one after the other, as an agent does within an episode; keywords set its senses."""

    def __init__(self, **senses: Any) -> None:
        self.scene = new(Scene)
        self.senses = new(Senses)
        set_senses(self.senses[0], **{"grid": 2, "threats": THREATS_2010, **senses})

    def __call__(self, observation: Observation) -> list[Object]:
        """Return the objects of a screen."""
        assert look(cast(Scene, self.scene[0]), cast(Senses, self.senses[0]), observation.body)
        count = int(self.scene["count"][0])
        return [cast(Object, thing) for thing in self.scene["objects"][0][:count].view(np.recarray).copy()]

    @property
    def screen(self) -> Screen:
        """The tiles and sprites seen last."""
        return cast(Screen, self.scene.view(np.recarray)[0].screen)


def watched(observation: Observation) -> Watcher:
    """Return a watcher that has seen a screen."""
    watcher = Watcher()
    watcher(observation)
    return watcher


def key(first: int, *others: int) -> int:
    """Return the key of a row of whole numbers."""
    found = feature(first)
    for number in others:
        found = extend(np.uint64(found), number)
    return int(found)


def learned(agent: MarioLearner) -> dict[int, float]:
    """Return the values that an agent has learned, by key."""
    saved = unpack(agent.agent_save(), agent.name, agent._settings())
    return dict(zip(saved.arrays["keys"].tolist(), saved.arrays["values"].tolist(), strict=True))
