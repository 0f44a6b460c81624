"""Task specs of spaces with Gymnasium's names: `task_spec(Discrete(21), Discrete(2), rewards=(-1, 1))`."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from glue.errors import TaskSpecError
from glue.taskspec.parser import RL_GLUE_3, TaskSpec
from glue.taskspec.space import MAX_COUNT, Bound, Range, Ranges, Space, equal_runs


def Discrete(n: int, start: int = 0) -> Space:
    """Return the space of one int from `start` to `start` + `n` - 1.

    Raises:
        TaskSpecError: `n` is below 1, or a bound does not fit 32 bits.
    """
    if n < 1:
        raise TaskSpecError(f"Discrete has at least one value, not {n}")
    return Space(ints=Ranges.of(Range(start, start + n - 1)))


def Box(
    low: float | npt.ArrayLike,
    high: float | npt.ArrayLike,
    shape: tuple[int, ...] | None = None,
    dtype: type[float] | type[int] = float,
) -> Space:
    """Return the space of an array of numbers between two bounds, ends included, in C order.

    Args:
        low: the minimum: one number, or one for each element; -inf if there is none.
        high: the maximum, likewise; inf if there is none.
        shape: the array's shape; by default that of `low` and `high`, where one number is one element.
        dtype: float for doubles, int for ints of 32 bits.

    Raises:
        TaskSpecError: the bounds do not fit the shape or the type, or a minimum is above its maximum.
    """
    if dtype not in (float, int):
        raise TaskSpecError(f"a Box is of float or int, not {dtype!r}")
    try:
        wanted = np.broadcast_shapes(np.shape(low), np.shape(high)) if shape is None else tuple(shape)
        if np.prod(wanted, dtype=float) > MAX_COUNT:
            raise TaskSpecError(f"a Box of shape {wanted} has more than {MAX_COUNT} numbers")
        ends = [np.broadcast_to(np.asarray(bound, np.float64), wanted).ravel() for bound in (low, high)]
    except ValueError as error:
        raise TaskSpecError(f"the bounds of a Box do not fit its shape: {error}") from None
    if dtype is float:
        return Space(doubles=Ranges(tuple((n, Range(*pair)) for n, *pair in equal_runs(*ends))))
    runs = [(n, [int(end) if end.is_integer() else end for end in pair]) for n, *pair in equal_runs(*ends)]
    return Space(ints=Ranges(tuple((n, Range(*pair)) for n, pair in runs)))


def Chars(count: int) -> Space:
    """Return the space of `count` bytes.

    Raises:
        TaskSpecError: the count is negative, or above 2**24.
    """
    return Space(chars=count)


def Tuple(*parts: Space) -> Space:
    """Return the space of several values: their ints one after the other, then doubles, then chars."""
    return Space(
        Ranges(tuple(run for part in parts for run in part.ints.runs)),
        Ranges(tuple(run for part in parts for run in part.doubles.runs)),
        sum(part.chars for part in parts),
    )


def task_spec(
    observations: Space,
    actions: Space,
    *,
    rewards: tuple[Bound, Bound] = (None, None),
    discount: float = 1.0,
    problem_type: str = "episodic",
    extra: str = "",
) -> str:
    """Return the text of a task spec, as `env_init` returns it.

    Args:
        observations: the space of observations.
        actions: the space of actions.
        rewards: the minimum and maximum reward of a step; None if not stated, infinite if there is none.
        discount: the discount factor, from 0 to 1.
        problem_type: `episodic`, `continuing` or another single word.
        extra: free text, such as the name of the task.

    Raises:
        TaskSpecError: a value is out of range, or the text is longer than 65,536 characters.
    """
    return str(TaskSpec(RL_GLUE_3, problem_type, discount, observations, actions, Range(*rewards), extra))
