"""Task specs from spaces."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from env_server.toys import MinesEnvironment, SkeletonEnvironment
from glue import TaskSpecError, taskspec
from glue.taskspec.spaces import Box, Chars, Discrete, Tuple, task_spec


@pytest.mark.parametrize(
    ("space", "text"),
    [
        (Discrete(21), "INTS (0 20)"),
        (Discrete(3, start=-1), "INTS (-1 1)"),
        (Box(-1.0, 1.0), "DOUBLES (-1.0 1.0)"),
        (Box(0, 1, (2, 3)), "DOUBLES (6 0.0 1.0)"),
        (Box([-1, 0, 0], [1, 1, 1], dtype=int), "INTS (-1 1) (2 0 1)"),
        (Box(-np.inf, np.array([[1.0, np.inf]])), "DOUBLES (NEGINF 1.0) (NEGINF POSINF)"),
        (Box(0, np.inf, (2,), int), "INTS (2 0 POSINF)"),
        (Box(0, 1, (0,)), ""),
        (Chars(5), "CHARCOUNT 5"),
        (Tuple(Box(0, 1), Discrete(2), Chars(1), Discrete(2)), "INTS (2 0 1) DOUBLES (0.0 1.0) CHARCOUNT 1"),
    ],
)
def test_spaces_are_those_of_the_task_spec_language(space: taskspec.Space, text: str) -> None:
    assert str(space) == text
    spec = taskspec.parse_task_spec(task_spec(space, Discrete(2), discount=0.5, rewards=(0, None), extra="x"))
    assert (spec.observations, spec.actions, spec.discount) == (space, Discrete(2), 0.5)
    assert (spec.rewards, spec.extra) == (taskspec.Range(0, None), "x")


@pytest.mark.parametrize(
    ("make", "arguments"),
    [
        (Discrete, (0,)),
        (Discrete, (2, 2**31 - 1)),
        (Box, (1, 0)),
        (Box, ([0, 0], [1, 1, 1])),
        (Box, (0, [1, 1], (3,))),
        (Box, (0, 1, (2**24 + 1,))),
        (Box, (0, 1, (-1,))),
        (Box, (0, 1.5, (), int)),
        (Box, (0, 1, (), np.uint8)),
        (Box, ("low", 1)),
        (Chars, (-1,)),
    ],
)
def test_wrong_spaces_are_refused(make: Any, arguments: tuple[Any, ...]) -> None:
    with pytest.raises(TaskSpecError):
        make(*arguments)


def test_task_specs_of_the_toys_are_as_runs_have_recorded_them() -> None:
    head = "VERSION RL-Glue-3.0 PROBLEMTYPE episodic DISCOUNTFACTOR 1.0 "
    assert SkeletonEnvironment().env_init() == head + (
        "OBSERVATIONS INTS (0 20) ACTIONS INTS (0 1) REWARDS (-1.0 1.0) EXTRA skeleton"
    )
    assert MinesEnvironment().env_init() == head + (
        "OBSERVATIONS INTS (0 107) ACTIONS INTS (0 3) REWARDS (-100.0 10.0) EXTRA mines"
    )
