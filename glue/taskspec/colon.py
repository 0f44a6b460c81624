"""The colon format of RL-Glue 2.x, versions 1 to 3, such as ``2:e:1_[i]_[0,20]:1_[i]_[0,1]:[-1,1]``.

    version : problem type : observations : actions [: rewards [: extra text]]

The version says no more than which of the last two may be there; they are read wherever they are.
Reading separates ints from doubles, so how the two were mixed is lost.
Source: RL-Glue 2.x task specs, and the conversion of RL-Glue 3.0's Java codec.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Final, NamedTuple

from glue.taskspec.scanner import Scanner
from glue.taskspec.space import NEGINF, POSINF, Bound, Range, Ranges, Space

COLON_FORMAT: Final = re.compile(r"[123](?:\.0)?\s*+:")

_SPECIALS: Final[Mapping[str, Bound]] = {"-INF": NEGINF, "INF": POSINF}
_PROBLEMS: Final = {"e": "episodic", "c": "continuing"}
_PROBLEM: Final = re.compile(r"[A-Za-z]++")
_COUNT: Final = re.compile(r"[0-9]{1,8}+")
_LETTER: Final = re.compile(r"[if](?=[\s,\]])", re.IGNORECASE)
_BOUND: Final = re.compile(r"[^\s:_,\[\]]++")


class ColonSpec(NamedTuple):
    """What a text in the colon format says."""

    problem_type: str
    observations: Space
    actions: Space
    rewards: Range
    extra: str


def read_colon(scan: Scanner) -> ColonSpec:
    """Return what follows a match of `COLON_FORMAT`.

    Raises:
        TaskSpecError: it is not as the format has it.
    """
    problem = scan.expect(_PROBLEM, "e, c or another word")
    scan.expect_sign(":")
    observations = _read_space(scan)
    scan.expect_sign(":")
    actions = _read_space(scan)
    rewards, extra = Range(), ""
    if scan.take_sign(":"):
        if scan.take_sign("["):
            rewards = _read_range(scan, whole=False)
        if scan.take_sign(":"):
            extra = scan.rest()
    scan.expect_end("':'")
    return ColonSpec(_PROBLEMS.get(problem.lower(), problem), observations, actions, rewards, extra)


def _read_space(scan: Scanner) -> Space:
    at = scan.skip()
    count = int(scan.expect(_COUNT, "a number of dimensions"))
    scan.expect_sign("_")
    scan.expect_sign("[")
    letters: list[str] = []
    while not scan.take_sign("]"):
        # A stray comma is passed over: published specs have them.
        if not scan.take_sign(","):
            letters.append(scan.expect(_LETTER, "i, f, ',' or ']'").lower())
    if len(letters) != count:
        raise scan.error(at, f"{count} dimensions need as many letters; {len(letters)} came")
    ranges: list[Range] = []
    while len(ranges) < count and scan.take_sign("_"):
        scan.expect_sign("[")
        ranges.append(_read_range(scan, whole=letters[len(ranges)] == "i"))
    if not ranges:
        ranges = [Range()] * count
    if len(ranges) != count:
        raise scan.unexpected(f"'_' and the range of dimension {len(ranges) + 1} of {count}")
    rows: dict[str, list[Range]] = {"i": [], "f": []}
    for letter, range_ in zip(letters, ranges, strict=True):
        rows[letter].append(range_)
    return Space(Ranges.of(*rows["i"]), Ranges.of(*rows["f"]))


def _read_range(scan: Scanner, *, whole: bool) -> Range:
    """Return the range whose opening bracket has just been passed, and go past the closing one."""
    at = scan.at - 1
    low, high = _read_bound(scan, whole=whole), None
    if scan.take_sign(","):
        high = _read_bound(scan, whole=whole)
    elif low is not None:
        raise scan.unexpected("','")
    scan.expect_sign("]")
    with scan.blaming(at):
        return Range(low, high)


def _read_bound(scan: Scanner, *, whole: bool) -> Bound:
    at = scan.skip()
    word = scan.take(_BOUND)
    return None if word is None else scan.bound(at, word, _SPECIALS, whole=whole)
