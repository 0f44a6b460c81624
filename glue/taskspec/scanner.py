"""Read a text from left to right, and say where it is not as expected.

White space in front of anything is passed over. No pattern can backtrack far, so the time to read a
text grows as its length, whatever the text.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Final

from glue.errors import TaskSpecError
from glue.taskspec.space import INT32_MAX, INT32_MIN, Bound

NUMBER: Final = re.compile(r"[+-]?(?:[0-9]++(?:\.[0-9]*+)?|\.[0-9]++)(?:[eE][+-]?[0-9]++)?")

# No leading zeros, which C read as octal. 4.0 is a whole number because some environments print ints so.
_WHOLE: Final = re.compile(r"([+-]?(?:0|[1-9][0-9]{0,9}))(?:\.0*+)?")
_SPACE: Final = re.compile(r"\s*+")
_EXCERPT: Final = 24


class Scanner:
    """A text, and the place that has been reached in it."""

    def __init__(self, text: str) -> None:
        self.text = text
        self.at = 0

    def skip(self) -> int:
        """Go past white space, and return the place that is reached."""
        match = _SPACE.match(self.text, self.at)
        assert match is not None  # It matches the empty text.
        self.at = match.end()
        return self.at

    def take(self, pattern: re.Pattern[str]) -> str | None:
        """Return what matches `pattern` next and go past it, or return None."""
        match = pattern.match(self.text, self.skip())
        if match is None:
            return None
        self.at = match.end()
        return match[0]

    def take_sign(self, sign: str) -> bool:
        """Go past `sign` if it comes next, and return whether it did."""
        found = self.text.startswith(sign, self.skip())
        if found:
            self.at += len(sign)
        return found

    def expect(self, pattern: re.Pattern[str], what: str) -> str:
        """Return what matches `pattern` next and go past it.

        Raises:
            TaskSpecError: something else comes; `what` is what was expected.
        """
        taken = self.take(pattern)
        if taken is None:
            raise self.unexpected(what)
        return taken

    def expect_sign(self, sign: str) -> None:
        """Go past `sign`.

        Raises:
            TaskSpecError: something else comes.
        """
        if not self.take_sign(sign):
            raise self.unexpected(repr(sign))

    def ahead(self, pattern: re.Pattern[str]) -> bool:
        """Return whether `pattern` matches what comes next."""
        return pattern.match(self.text, self.skip()) is not None

    def expect_end(self, what: str) -> None:
        """Do nothing at the end.

        Raises:
            TaskSpecError: something comes; `what` is what could have come.
        """
        if self.skip() < len(self.text):
            raise self.unexpected(f"{what} or the end")

    def rest(self) -> str:
        """Return what is left, without the white space around it, and go to the end."""
        rest = self.text[self.at :].strip()
        self.at = len(self.text)
        return rest

    def bound(self, at: int, word: str, specials: Mapping[str, Bound], *, whole: bool) -> Bound:
        """Return the bound that `word`, which began at `at`, stands for: a special, a double or an int.

        Raises:
            TaskSpecError: it is none, or does not fit a double, or, if `whole`, 32 bits.
        """
        if word.upper() in specials:
            return specials[word.upper()]
        if not NUMBER.fullmatch(word):
            raise self.error(at, f"expected {either('a number', *specials)}, not {_excerpt(word)}")
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
        """Return the whole number that `word`, which began at `at`, stands for.

        Raises:
            TaskSpecError: it is no whole number, or has leading zeros, or more than ten digits.
        """
        match = _WHOLE.fullmatch(word)
        if match is None:
            raise self.error(at, f"expected a whole number without leading zeros, not {_excerpt(word)}")
        return int(match[1])

    @contextmanager
    def blaming(self, at: int) -> Iterator[None]:
        """Give a TaskSpecError raised inside the place `at`."""
        try:
            yield
        except TaskSpecError as error:
            raise self.error(at, str(error)) from None

    def unexpected(self, what: str) -> TaskSpecError:
        """Return an error at the place reached: `what` was expected, and what came instead."""
        ahead = self.text[self.skip() : self.at + _EXCERPT + 1]
        return self.error(
            self.at, f"expected {what}, " + (f"not {_excerpt(ahead)}" if ahead else "not the end")
        )

    def error(self, at: int, complaint: str) -> TaskSpecError:
        """Return an error at a place; people count characters from 1."""
        return TaskSpecError(f"task spec, character {at + 1}: {complaint}")


def either(*words: str) -> str:
    """Return ``a, b or c``."""
    return " or ".join(filter(None, (", ".join(words[:-1]), words[-1])))


def _excerpt(text: str) -> str:
    return repr(text if len(text) <= _EXCERPT else text[:_EXCERPT] + "...")
