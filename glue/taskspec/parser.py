"""Task specs as values, and their parser: a scanner, and the two formats that are read with it.

White space before any token is skipped. No pattern can backtrack far, so the time to parse any text is
linear in its length. The grammar is in docs/taskspec.md.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Final, NamedTuple, Self

from glue.errors import TaskSpecError
from glue.taskspec.space import (
    INT32_MAX,
    INT32_MIN,
    MAX_COUNT,
    NEGINF,
    POSINF,
    UNSPEC,
    Bound,
    Range,
    Ranges,
    Run,
    Space,
)

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


_SPECIALS: Final[Mapping[str, Bound]] = {"NEGINF": NEGINF, "POSINF": POSINF, "UNSPEC": UNSPEC}
_BOUND: Final = re.compile(r"(?:NEGINF|POSINF|UNSPEC)(?![^\s()])|[-+.0-9][^\s()]*+", re.IGNORECASE)
_NUMBER: Final = re.compile(r"[+-]?(?:[0-9]++(?:\.[0-9]*+)?|\.[0-9]++)(?:[eE][+-]?[0-9]++)?")

# No leading zeros, which C read as octal. 4.0 is a whole number since some environments print ints like that.
_WHOLE: Final = re.compile(r"([+-]?(?:0|[1-9][0-9]{0,9}))(?:\.0*+)?")
_SPACE: Final = re.compile(r"\s*+")
_EXCERPT: Final = 24

_PARTS: Final = ("INTS", "DOUBLES", "CHARCOUNT")
_KEYWORDS: Final = {
    word: re.compile(word + after, re.IGNORECASE)
    for words, after in (
        (("VERSION", "PROBLEMTYPE"), r"(?!\S)"),  # Text follows, so a space must come between.
        (("EXTRA",), r"S?(?!\S)"),  # Public environments write EXTRAS, which the original parsers read.
        (("DISCOUNTFACTOR", "OBSERVATIONS", "ACTIONS", "REWARDS", *_PARTS), ""),
    )
    for word in words
}


def parse_task_spec(text: str) -> TaskSpec:
    """Parse a task spec.

    The colon format is converted to RL-Glue-3.0 with a discount factor of 1.

    Raises:
        TaskSpecError: the text is not RL-Glue-3.0, Mario-v1, the colon format or a private format
            (``VERSION name ...``), or is longer than `MAX_LENGTH`. The message gives the position, in
            characters counted from 1, and the expected and the received text.
    """
    if len(text) > MAX_LENGTH:
        raise TaskSpecError(f"a task spec has at most {MAX_LENGTH} characters; {len(text)} received")
    scan = _Scanner(text)
    if scan.take(_COLON_FORMAT):
        return _read_colon(scan)
    scan.expect(_KEYWORDS["VERSION"], "VERSION, or the colon format such as 2:e:1_[i]_[0,9]:1_[i]_[0,1]")
    name = scan.expect(VERSION_NAME, f"the name of a version such as {RL_GLUE_3}")
    version = PUBLIC.get(name.lower())
    return TaskSpec.private(name, scan.rest()) if version is None else _read_public(scan, version)


def _read_public(scan: _Scanner, version: str) -> TaskSpec:
    _expect_keyword(scan, "PROBLEMTYPE")
    problem_type = scan.expect(PROBLEM_TYPE, "a problem type such as episodic")
    _expect_keyword(scan, "DISCOUNTFACTOR")
    discount = _read_discount(scan)
    if version == MARIO and not scan.ahead(_KEYWORDS["OBSERVATIONS"]):
        observations = UNSTATED
        _expect_keyword(scan, "ACTIONS")
    else:
        _expect_keyword(scan, "OBSERVATIONS")
        observations = _read_space(scan, "ACTIONS")
    actions = _read_space(scan, "REWARDS")
    rewards = _read_rewards(scan)
    extra = scan.rest() if _take_keyword(scan, "EXTRA") else ""
    scan.expect_end("EXTRA")
    return TaskSpec(version, problem_type, discount, observations, actions, rewards, extra)


def _read_discount(scan: _Scanner) -> float:
    at = scan.skip()
    discount = float(scan.expect(_NUMBER, "a discount factor from 0 to 1"))
    if not 0 <= discount <= 1:
        raise scan.error(at, f"expected a discount factor from 0 to 1, not {discount}")
    return discount


def _read_space(scan: _Scanner, following: str) -> Space:
    """Read the parts of a space and the keyword that follows it; return the space."""
    ints, doubles, chars = Ranges(), Ranges(), 0
    left = list(_PARTS)
    while not _take_keyword(scan, following):
        at = scan.skip()
        part = next((part for part in _PARTS if _take_keyword(scan, part)), None)
        if part is None:
            raise scan.unexpected(_either(*left, following))
        if part not in left:
            raise scan.error(at, f"{part} is given twice")
        left.remove(part)
        if part == "INTS":
            ints = _read_ranges(scan, whole=True)
        elif part == "DOUBLES":
            doubles = _read_ranges(scan, whole=False)
        else:
            chars = _count(scan, scan.skip(), scan.expect(_NUMBER, "a number of chars"))
    return Space(ints, doubles, chars)


def _read_ranges(scan: _Scanner, *, whole: bool) -> Ranges:
    at = scan.skip()
    runs: list[Run] = []
    while scan.take_sign("("):
        words = _read_words(scan)
        repeat = _count(scan, *words[0]) if len(words) == 3 else 1
        runs.append((repeat, _range(scan, words, whole=whole)))
    with scan.blaming(at):
        return Ranges(tuple(runs))


def _read_rewards(scan: _Scanner) -> Range:
    if not scan.take_sign("("):
        return Range()
    words = _read_words(scan)
    # The Java codec wrote a repeat of 1 until January 2009.
    if len(words) == 3 and (repeat := _count(scan, *words[0])) != 1:
        raise scan.error(words[0].at, f"a reward is one number, so its range is not repeated {repeat} times")
    return _range(scan, words, whole=False)


def _read_words(scan: _Scanner) -> list[_Word]:
    """Read two or three words and the closing parenthesis; return the words."""
    words: list[_Word] = []
    while not scan.take_sign(")"):
        at = scan.skip()
        word = scan.take(_BOUND)
        if word is None or len(words) == 3:
            for known in words:
                scan.bound(known.at, known.text, _SPECIALS, whole=False)  # An earlier word may be to blame.
            scan.at = at
            raise scan.unexpected("')'" if len(words) > 1 else _either("a number", *_SPECIALS))
        words.append(_Word(at, word))
    if len(words) < 2:
        raise scan.error(scan.at - 1, f"a range has two bounds, maybe after a repeat; {len(words)} received")
    return words


def _range(scan: _Scanner, words: list[_Word], *, whole: bool) -> Range:
    low, high = (scan.bound(word.at, word.text, _SPECIALS, whole=whole) for word in words[-2:])
    with scan.blaming(words[-2].at):
        return Range(low, high)


def _count(scan: _Scanner, at: int, text: str) -> int:
    count = scan.integer(at, text)
    if not 0 <= count <= MAX_COUNT:
        raise scan.error(at, f"expected a whole number from 0 to {MAX_COUNT}, not {count}")
    return count


def _take_keyword(scan: _Scanner, word: str) -> bool:
    return scan.take(_KEYWORDS[word]) is not None


def _expect_keyword(scan: _Scanner, word: str) -> None:
    scan.expect(_KEYWORDS[word], word)


# The colon format of RL-Glue 2.x, versions 1 to 3, such as 2:e:1_[i]_[0,20]:1_[i]_[0,1]:[-1,1].
#
#     version : problem type : observations : actions [: rewards [: extra text]]
#
# The version determines only which of the last two may be present; they are read with any version.
# Ints are separated from doubles, so their order in the text is lost.
# Source: RL-Glue 2.x task specs, and the conversion of RL-Glue 3.0's Java codec.

_COLON_FORMAT: Final = re.compile(r"[123](?:\.0)?\s*+:")

_COLON_SPECIALS: Final[Mapping[str, Bound]] = {"-INF": NEGINF, "INF": POSINF}
_COLON_PROBLEMS: Final = {"e": "episodic", "c": "continuing"}
_COLON_PROBLEM: Final = re.compile(r"[A-Za-z]++")
_COLON_COUNT: Final = re.compile(r"[0-9]{1,8}+")
_COLON_LETTER: Final = re.compile(r"[if](?=[\s,\]])", re.IGNORECASE)
_COLON_BOUND: Final = re.compile(r"[^\s:_,\[\]]++")
# Several are one, as in the Java parser: environments of rl-library send two.
_COLON_JOINT: Final = re.compile(r"_(?:\s*+_)*+")


def _read_colon(scan: _Scanner) -> TaskSpec:
    """Read the rest of a task spec after a match of `_COLON_FORMAT`.

    Raises:
        TaskSpecError: the text does not conform to the format.
    """
    problem = scan.expect(_COLON_PROBLEM, "e, c or another word")
    scan.expect_sign(":")
    observations = _read_colon_space(scan)
    scan.expect_sign(":")
    actions = _read_colon_space(scan)
    rewards, extra = Range(), ""
    if scan.take_sign(":"):
        if scan.take_sign("["):
            rewards = _read_colon_range(scan, whole=False)
        if scan.take_sign(":"):
            extra = scan.rest()
    scan.expect_end("':'")
    problem_type = _COLON_PROBLEMS.get(problem.lower(), problem)
    return TaskSpec(RL_GLUE_3, problem_type, 1.0, observations, actions, rewards, extra)


def _read_colon_space(scan: _Scanner) -> Space:
    at = scan.skip()
    count = int(scan.expect(_COLON_COUNT, "a number of dimensions"))
    scan.expect(_COLON_JOINT, "'_'")
    scan.expect_sign("[")
    letters: list[str] = []
    while not scan.take_sign("]"):
        # Stray commas are skipped: published specs have them.
        if not scan.take_sign(","):
            letters.append(scan.expect(_COLON_LETTER, "i, f, ',' or ']'").lower())
    if len(letters) != count:
        raise scan.error(at, f"{count} dimensions need as many letters; {len(letters)} received")
    ranges: list[Range] = []
    while len(ranges) < count and scan.take(_COLON_JOINT):
        scan.expect_sign("[")
        ranges.append(_read_colon_range(scan, whole=letters[len(ranges)] == "i"))
    if not ranges:
        ranges = [Range()] * count
    if len(ranges) != count:
        raise scan.unexpected(f"'_' and the range of dimension {len(ranges) + 1} of {count}")
    rows: dict[str, list[Range]] = {"i": [], "f": []}
    for letter, range_ in zip(letters, ranges, strict=True):
        rows[letter].append(range_)
    return Space(Ranges.of(*rows["i"]), Ranges.of(*rows["f"]))


def _read_colon_range(scan: _Scanner, *, whole: bool) -> Range:
    """Read a range after its opening bracket, and the closing bracket; return the range."""
    at = scan.at - 1
    low, high = _read_colon_bound(scan, whole=whole), None
    if scan.take_sign(","):
        high = _read_colon_bound(scan, whole=whole)
    elif low is not None:
        raise scan.unexpected("','")
    scan.expect_sign("]")
    with scan.blaming(at):
        return Range(low, high)


def _read_colon_bound(scan: _Scanner, *, whole: bool) -> Bound:
    at = scan.skip()
    word = scan.take(_COLON_BOUND)
    return None if word is None else scan.bound(at, word, _COLON_SPECIALS, whole=whole)


class _Word(NamedTuple):
    at: int
    text: str


class _Scanner:
    """A text, and the current position in it."""

    def __init__(self, text: str) -> None:
        self.text = text
        self.at = 0

    def skip(self) -> int:
        """Skip white space, and return the position after it."""
        match = _SPACE.match(self.text, self.at)
        assert match is not None  # It matches the empty text.
        self.at = match.end()
        return self.at

    def take(self, pattern: re.Pattern[str]) -> str | None:
        """Return the next text and skip it if it matches `pattern`; return None if not."""
        match = pattern.match(self.text, self.skip())
        if match is None:
            return None
        self.at = match.end()
        return match[0]

    def take_sign(self, sign: str) -> bool:
        """Skip `sign` if it is next, and return whether it was."""
        found = self.text.startswith(sign, self.skip())
        if found:
            self.at += len(sign)
        return found

    def expect(self, pattern: re.Pattern[str], what: str) -> str:
        """Return the next text, which has to match `pattern`, and skip it.

        Raises:
            TaskSpecError: the text does not match; `what` describes the expected text.
        """
        taken = self.take(pattern)
        if taken is None:
            raise self.unexpected(what)
        return taken

    def expect_sign(self, sign: str) -> None:
        """Skip `sign`.

        Raises:
            TaskSpecError: the text does not continue with `sign`.
        """
        if not self.take_sign(sign):
            raise self.unexpected(repr(sign))

    def ahead(self, pattern: re.Pattern[str]) -> bool:
        """Return whether `pattern` matches the next text."""
        return pattern.match(self.text, self.skip()) is not None

    def expect_end(self, what: str) -> None:
        """Check that the end is reached.

        Raises:
            TaskSpecError: there is more text; `what` describes the text that would have been allowed.
        """
        if self.skip() < len(self.text):
            raise self.unexpected(f"{what} or the end")

    def rest(self) -> str:
        """Return the rest of the text, without the white space around it, and skip it."""
        rest = self.text[self.at :].strip()
        self.at = len(self.text)
        return rest

    def bound(self, at: int, word: str, specials: Mapping[str, Bound], *, whole: bool) -> Bound:
        """Return the value of a bound, which begins at `at`: a special, a double or an int.

        Raises:
            TaskSpecError: `word` is not a bound, or does not fit a double, or, if `whole`, 32 bits.
        """
        if word.upper() in specials:
            return specials[word.upper()]
        if not _NUMBER.fullmatch(word):
            raise self.error(at, f"expected {_either('a number', *specials)}, not {_excerpt(word)}")
        if not whole:
            number = float(word)
            if math.isinf(number):
                raise self.error(at, f"expected a number that a double holds, not {_excerpt(word)}")
            return number
        integer = self.integer(at, word)
        if not INT32_MIN <= integer <= INT32_MAX:
            raise self.error(at, f"expected a whole number of 32 bits, not {integer}")
        return integer

    def integer(self, at: int, word: str) -> int:
        """Return the value of a whole number, which begins at `at`.

        Raises:
            TaskSpecError: `word` is not a whole number, or has leading zeros, or more than ten digits.
        """
        match = _WHOLE.fullmatch(word)
        if match is None:
            raise self.error(at, f"expected a whole number without leading zeros, not {_excerpt(word)}")
        return int(match[1])

    @contextmanager
    def blaming(self, at: int) -> Iterator[None]:
        """Add the position `at` to a TaskSpecError raised inside the block."""
        try:
            yield
        except TaskSpecError as error:
            raise self.error(at, str(error)) from None

    def unexpected(self, what: str) -> TaskSpecError:
        """Return an error at the current position, with the expected text, `what`, and the received text."""
        ahead = self.text[self.skip() : self.at + _EXCERPT + 1]
        return self.error(
            self.at, f"expected {what}, " + (f"not {_excerpt(ahead)}" if ahead else "not the end")
        )

    def error(self, at: int, complaint: str) -> TaskSpecError:
        """Return an error at a position, which the message counts from 1."""
        return TaskSpecError(f"task spec, character {at + 1}: {complaint}")


def _either(*words: str) -> str:
    """Return ``a, b or c``."""
    return " or ".join(filter(None, (", ".join(words[:-1]), words[-1])))


def _excerpt(text: str) -> str:
    return repr(text if len(text) <= _EXCERPT else text[:_EXCERPT] + "...")
