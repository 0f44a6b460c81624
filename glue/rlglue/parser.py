"""The task spec parser of RL-Glue's Python codec, for its agents, with its original names."""

from __future__ import annotations

from typing import Final

from glue.errors import TaskSpecError
from glue.taskspec import NEGINF, POSINF, UNSPEC, Bound, Range, Ranges, TaskSpec, parse_task_spec

Bounds = list["float | str"]
"""Minimum and maximum of a number; NEGINF, POSINF and UNSPEC are texts."""

_SPECIAL: Final = ("UNSPEC", "NEGINF", "POSINF")


class TaskSpecParser:
    """A task spec. The methods are those of rlglue/utils/TaskSpecVRLGLUE3.py.

    Args:
        text: the task spec.

    Attributes:
        valid: whether it can be read.
    """

    def __init__(self, text: str) -> None:
        self.ts: str = text
        self.valid: bool = True
        self.last_error: str = ""
        self._spec = TaskSpec.private("unreadable")
        try:
            self._spec = parse_task_spec(text)
        except TaskSpecError as error:
            self.valid = False
            self.last_error = str(error)

    def Validate(self) -> bool:
        """Return whether the task spec can be read."""
        return self.valid

    def getVersion(self) -> str:
        """Return the version."""
        return self._spec.version

    def getProblemType(self) -> str:
        """Return the problem type."""
        return self._spec.problem_type

    def getDiscountFactor(self) -> float:
        """Return the discount factor."""
        return 1.0 if self._spec.discount is None else float(self._spec.discount)

    def getExtra(self) -> str:
        """Return the text after EXTRA."""
        return self._spec.extra

    def getIntObservations(self) -> list[Bounds]:
        """Return the bounds of each int of an observation."""
        return _bounds(self._spec.observations.ints)

    def getDoubleObservations(self) -> list[Bounds]:
        """Return the bounds of each double of an observation."""
        return _bounds(self._spec.observations.doubles)

    def getCharCountObservations(self) -> int:
        """Return the number of chars of an observation."""
        return self._spec.observations.chars

    def getIntActions(self) -> list[Bounds]:
        """Return the bounds of each int of an action."""
        return _bounds(self._spec.actions.ints)

    def getDoubleActions(self) -> list[Bounds]:
        """Return the bounds of each double of an action."""
        return _bounds(self._spec.actions.doubles)

    def getCharCountActions(self) -> int:
        """Return the number of chars of an action."""
        return self._spec.actions.chars

    def getRewardRange(self) -> list[Bounds]:
        """Return the bounds of the reward, in a list of one."""
        return [_pair(self._spec.rewards)]

    def isSpecial(self, bound: object) -> bool:
        """Return whether a bound is not a number."""
        return bound in _SPECIAL


def _bounds(ranges: Ranges) -> list[Bounds]:
    return [_pair(range_) for range_ in ranges]


def _pair(range_: Range) -> Bounds:
    return [_bound(range_.low), _bound(range_.high)]


def _bound(bound: Bound) -> float | str:
    if bound is UNSPEC:
        return "UNSPEC"
    return {NEGINF: "NEGINF", POSINF: "POSINF"}.get(bound, bound)
