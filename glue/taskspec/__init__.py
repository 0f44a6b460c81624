"""The RL-Glue task spec language: what an environment says of its observations, actions and rewards.

    spec = parse_task_spec(text)
    spec.actions.ints[0].high        # the greatest value of the first int of an action
    spec.actions.check(action)       # None, or why the action is not legal
    str(spec)                        # the canonical text

`parse_task_spec` is tolerant, `str` is canonical, and a printed spec reads back to an equal value.
What is tolerated and what is refused is in docs/taskspec.md.
Source: RL-Glue 3.0 task spec language; for Mario-v1, RL-Competition 2009.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final, NamedTuple, Self

from glue.errors import TaskSpecError
from glue.taskspec.colon import COLON_FORMAT, read_colon
from glue.taskspec.scanner import NUMBER, Scanner, either
from glue.taskspec.space import MAX_COUNT, NEGINF, POSINF, UNSPEC, Bound, Range, Ranges, Run, Space

__all__ = [
    "MARIO",
    "MAX_TEXT",
    "NEGINF",
    "POSINF",
    "RL_GLUE_3",
    "UNSPEC",
    "Bound",
    "Range",
    "Ranges",
    "Space",
    "TaskSpec",
    "parse_task_spec",
]

RL_GLUE_3: Final = "RL-Glue-3.0"
MARIO: Final = "Mario-v1"
MAX_TEXT: Final = 2**16  # Characters.

_PUBLIC: Final = {name.lower(): name for name in (RL_GLUE_3, MARIO)}
_UNSTATED: Final = Space(stated=False)
_SPECIALS: Final[Mapping[str, Bound]] = {"NEGINF": NEGINF, "POSINF": POSINF, "UNSPEC": UNSPEC}

# A word ends where the next keyword begins, because published specs leave out spaces. These two are not
# possessive, which a group cannot be before Python 3.11.5: there it forgets what must not follow.
_VERSION: Final = re.compile(r"(?:(?!PROBLEMTYPE)\S)+", re.IGNORECASE)
_PROBLEM: Final = re.compile(r"(?:(?!DISCOUNTFACTOR)[^\s()])+", re.IGNORECASE)
_BOUND: Final = re.compile(r"(?:NEGINF|POSINF|UNSPEC)(?![^\s()])|[-+.0-9][^\s()]*+", re.IGNORECASE)
_PARTS: Final = ("INTS", "DOUBLES", "CHARCOUNT")
_KEYWORDS: Final = {
    word: re.compile(word + after, re.IGNORECASE)
    for words, after in (
        (("VERSION", "PROBLEMTYPE", "EXTRA"), r"(?!\S)"),  # Text follows, so a space must come between.
        (("DISCOUNTFACTOR", "OBSERVATIONS", "ACTIONS", "REWARDS", *_PARTS), ""),
    )
    for word in words
}


class _Word(NamedTuple):
    at: int
    text: str


@dataclass(frozen=True, slots=True)
class TaskSpec:
    """What a task is like, as far as its environment says.

    Args:
        version: the name of the format. RL-Glue-3.0 states everything; Mario-v1 need not state the
            observations; any other is private to those who know it, and has nothing but `extra`.
        problem_type: ``episodic``, ``continuing`` or another single word; empty if private.
        discount: the discount factor, from 0 to 1, ends included; None if private.
        observations: what observations are made of.
        actions: what actions are made of.
        rewards: the range of the reward of one step.
        extra: free text; of a private format all that follows its name. White space around it is lost.

    Raises:
        TaskSpecError: a value is out of range, missing or not for this version, or the text of the
            task spec would be longer than `MAX_TEXT`.
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
        if self.version in _PUBLIC.values():
            self._check_public()
        else:
            self._check_private()
        length = len(str(self))
        if length > MAX_TEXT:
            raise TaskSpecError(
                f"a task spec has at most {MAX_TEXT} characters; the canonical text of this one has {length}"
            )

    @classmethod
    def private(cls, version: str, text: str = "") -> Self:
        """Return a task spec in a format of which no more is known than its name."""
        return cls(version, "", None, _UNSTATED, _UNSTATED, Range(), text)

    def _check_public(self) -> None:
        if not _PROBLEM.fullmatch(self.problem_type):
            raise TaskSpecError(f"a problem type is one word such as episodic, not {self.problem_type!r}")
        if self.discount is None or not 0 <= self.discount <= 1:
            raise TaskSpecError(f"a discount factor is from 0 to 1, not {self.discount}")
        if not self.actions.stated:
            raise TaskSpecError(f"{self.version} has to state the actions")
        if not self.observations.stated and self.version != MARIO:
            raise TaskSpecError(f"{self.version} has to state the observations")

    def _check_private(self) -> None:
        if not _VERSION.fullmatch(self.version) or self.version.lower() in _PUBLIC:
            raise TaskSpecError(f"a version is one word, spelt as in {RL_GLUE_3}, not {self.version!r}")
        rest = self.problem_type, self.discount, self.observations, self.actions, self.rewards
        if rest != ("", None, _UNSTATED, _UNSTATED, Range()):
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


def parse_task_spec(text: str) -> TaskSpec:
    """Return what a task spec says.

    The colon format becomes RL-Glue-3.0 with a discount factor of 1.

    Raises:
        TaskSpecError: the text is not RL-Glue-3.0, Mario-v1, the colon format or a private format
            (``VERSION name ...``), or is longer than `MAX_TEXT`. The message names the character,
            counted from 1, what was expected there and what came.
    """
    if len(text) > MAX_TEXT:
        raise TaskSpecError(f"a task spec has at most {MAX_TEXT} characters; {len(text)} came")
    scan = Scanner(text)
    if scan.take(COLON_FORMAT):
        colon = read_colon(scan)
        return TaskSpec(
            RL_GLUE_3, colon.problem_type, 1.0, colon.observations, colon.actions, colon.rewards, colon.extra
        )
    scan.expect(_KEYWORDS["VERSION"], "VERSION, or the colon format such as 2:e:1_[i]_[0,9]:1_[i]_[0,1]")
    name = scan.expect(_VERSION, f"the name of a version such as {RL_GLUE_3}")
    version = _PUBLIC.get(name.lower())
    return TaskSpec.private(name, scan.rest()) if version is None else _read_public(scan, version)


def _read_public(scan: Scanner, version: str) -> TaskSpec:
    _expect_keyword(scan, "PROBLEMTYPE")
    problem_type = scan.expect(_PROBLEM, "a problem type such as episodic")
    _expect_keyword(scan, "DISCOUNTFACTOR")
    discount = _read_discount(scan)
    if version == MARIO and not scan.ahead(_KEYWORDS["OBSERVATIONS"]):
        observations = _UNSTATED
        _expect_keyword(scan, "ACTIONS")
    else:
        _expect_keyword(scan, "OBSERVATIONS")
        observations = _read_space(scan, "ACTIONS")
    actions = _read_space(scan, "REWARDS")
    rewards = _read_rewards(scan)
    extra = scan.rest() if _take_keyword(scan, "EXTRA") else ""
    scan.expect_end("EXTRA")
    return TaskSpec(version, problem_type, discount, observations, actions, rewards, extra)


def _read_discount(scan: Scanner) -> float:
    at = scan.skip()
    discount = float(scan.expect(NUMBER, "a discount factor from 0 to 1"))
    if not 0 <= discount <= 1:
        raise scan.error(at, f"expected a discount factor from 0 to 1, not {discount}")
    return discount


def _read_space(scan: Scanner, following: str) -> Space:
    """Return the space whose parts come next, and go past the keyword that follows it."""
    ints, doubles, chars = Ranges(), Ranges(), 0
    left = list(_PARTS)
    while not _take_keyword(scan, following):
        at = scan.skip()
        part = next((part for part in _PARTS if _take_keyword(scan, part)), None)
        if part is None:
            raise scan.unexpected(either(*left, following))
        if part not in left:
            raise scan.error(at, f"{part} came a second time")
        left.remove(part)
        if part == "INTS":
            ints = _read_ranges(scan, whole=True)
        elif part == "DOUBLES":
            doubles = _read_ranges(scan, whole=False)
        else:
            chars = _count(scan, scan.skip(), scan.expect(NUMBER, "a number of chars"))
    return Space(ints, doubles, chars)


def _read_ranges(scan: Scanner, *, whole: bool) -> Ranges:
    at = scan.skip()
    runs: list[Run] = []
    while scan.take_sign("("):
        words = _read_words(scan)
        repeat = _count(scan, *words[0]) if len(words) == 3 else 1
        runs.append((repeat, _range(scan, words, whole=whole)))
    with scan.blaming(at):
        return Ranges(tuple(runs))


def _read_rewards(scan: Scanner) -> Range:
    if not scan.take_sign("("):
        return Range()
    words = _read_words(scan)
    if len(words) == 3:
        raise scan.error(words[0].at, "a reward is one number, so its range has no repeat")
    return _range(scan, words, whole=False)


def _read_words(scan: Scanner) -> list[_Word]:
    """Return the two or three words up to the closing parenthesis, and go past it."""
    words: list[_Word] = []
    while not scan.take_sign(")"):
        at = scan.skip()
        word = scan.take(_BOUND)
        if word is None or len(words) == 3:
            scan.at = at
            raise scan.unexpected("')'" if len(words) > 1 else either("a number", *_SPECIALS))
        words.append(_Word(at, word))
    if len(words) < 2:
        raise scan.error(scan.at - 1, f"a range has two bounds, maybe after a repeat; {len(words)} came")
    return words


def _range(scan: Scanner, words: list[_Word], *, whole: bool) -> Range:
    low, high = (scan.bound(word.at, word.text, _SPECIALS, whole=whole) for word in words[-2:])
    with scan.blaming(words[-2].at):
        return Range(low, high)


def _count(scan: Scanner, at: int, text: str) -> int:
    count = scan.integer(at, text)
    if not 0 <= count <= MAX_COUNT:
        raise scan.error(at, f"expected a whole number from 0 to {MAX_COUNT}, not {count}")
    return count


def _take_keyword(scan: Scanner, word: str) -> bool:
    return scan.take(_KEYWORDS[word]) is not None


def _expect_keyword(scan: Scanner, word: str) -> None:
    scan.expect(_KEYWORDS[word], word)
