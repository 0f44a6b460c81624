"""A task spec as a value: its checks and its canonical text."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Final, Self

from glue.errors import TaskSpecError
from glue.taskspec.space import Range, Space

RL_GLUE_3: Final = "RL-Glue-3.0"
MARIO: Final = "Mario-v1"

MASKS: Final = "masks"
"""Word in EXTRA of an environment whose observations may say which actions are legal."""

MAX_LENGTH: Final = 2**16
"""Maximum length of a task spec, in characters."""

PUBLIC: Final = {name.lower(): name for name in (RL_GLUE_3, MARIO)}
"""The formats that describe a task, by their names in lower case; all others are private."""

UNSTATED: Final = Space(stated=False)

# A word ends where the next keyword begins, because published specs leave out spaces. These two patterns are
# not possessive: in Python before 3.11.5 a possessive group ignores its lookahead.
VERSION_NAME: Final = re.compile(r"(?:(?!PROBLEMTYPE)\S)+", re.IGNORECASE)
PROBLEM_TYPE: Final = re.compile(r"(?:(?!DISCOUNTFACTOR)[^\s()])+", re.IGNORECASE)


@dataclass(frozen=True, slots=True)
class TaskSpec:
    """The description of a task by its environment.

    Args:
        version: the name of the format. RL-Glue-3.0 states everything; Mario-v1 need not state the
            observations; any other is a private format, of which only `extra` is known.
        problem_type: ``episodic``, ``continuing`` or another single word; empty if private.
        discount: the discount factor, from 0 to 1, ends included; None if private.
        observations: the space of observations.
        actions: the space of actions.
        rewards: the range of the reward of one step.
        extra: free text; in a private format, the text after its name. White space around it is removed.

    Raises:
        TaskSpecError: a value is out of range, missing or not part of this version, or the text of the
            task spec would be longer than `MAX_LENGTH`.
    """

    version: str
    problem_type: str
    discount: float | None
    observations: Space
    actions: Space
    rewards: Range
    extra: str = ""

    def __post_init__(self) -> None:
        object.__setattr__(self, "extra", self.extra.strip())
        if self.version in PUBLIC.values():
            self._check_public()
        else:
            self._check_private()
        length = len(str(self))
        if length > MAX_LENGTH:
            raise TaskSpecError(
                f"a task spec has at most {MAX_LENGTH} characters; "
                f"the canonical text of this one has {length}"
            )

    @property
    def masks(self) -> bool:
        """Whether observations may have masks of the legal actions: EXTRA has the word `masks`."""
        return MASKS in self.extra.split()

    @classmethod
    def private(cls, version: str, text: str = "") -> Self:
        """Return a task spec in a private format, of which only the name is known."""
        return cls(version, "", None, UNSTATED, UNSTATED, Range(), text)

    def _check_public(self) -> None:
        if not PROBLEM_TYPE.fullmatch(self.problem_type):
            raise TaskSpecError(f"a problem type is one word such as episodic, not {self.problem_type!r}")
        if self.discount is None or not 0 <= self.discount <= 1:
            raise TaskSpecError(f"a discount factor is from 0 to 1, not {self.discount}")
        if not self.actions.stated:
            raise TaskSpecError(f"{self.version} has to state the actions")
        if not self.observations.stated and self.version != MARIO:
            raise TaskSpecError(f"{self.version} has to state the observations")

    def _check_private(self) -> None:
        if not VERSION_NAME.fullmatch(self.version) or self.version.lower() in PUBLIC:
            raise TaskSpecError(f"a version is one word, spelt as in {RL_GLUE_3}, not {self.version!r}")
        rest = self.problem_type, self.discount, self.observations, self.actions, self.rewards
        if rest != ("", None, UNSTATED, UNSTATED, Range()):
            raise TaskSpecError(f"{self.version} is a private format: it has nothing but extra text")

    def __str__(self) -> str:
        parts = ["VERSION", self.version]
        if self.discount is not None:
            parts += ["PROBLEMTYPE", self.problem_type, "DISCOUNTFACTOR", repr(float(self.discount))]
            if self.observations.stated:
                parts += ["OBSERVATIONS", str(self.observations)]
            parts += ["ACTIONS", str(self.actions), "REWARDS", str(self.rewards)]
            # The original C and Java parsers need the word even if nothing follows it.
            if self.extra or self.version == RL_GLUE_3:
                parts.append("EXTRA")
        return " ".join(filter(None, (*parts, self.extra)))
