"""Errors in a TOML file that a user wrote, and the lines that they are about."""

from __future__ import annotations

import re
import tomllib
from typing import Any

from glue.errors import ExperimentError


class PlanError(ExperimentError):
    """A key or a value of a plan is wrong.

    Attributes:
        keys: the key, after those of the tables that it is in; empty if the error is about no key.
    """

    def __init__(self, message: str, *keys: str) -> None:
        super().__init__(message)
        self.keys = keys

    def inside(self, *keys: str) -> PlanError:
        """Return this error for a table that is inside others."""
        return PlanError(str(self), *keys, *self.keys)


def line_of(text: str, keys: tuple[str, ...]) -> int | None:
    """Return the line of a TOML text in which a key is set or, failing that, the table that has it."""
    table: tuple[str, ...] = ()
    best, found = 0, None
    for number, line in enumerate(text.splitlines(), 1):
        header = re.match(r"\s*(\[+[^\[\]]+\]+)\s*(#.*)?$", line)
        key = re.match(r"\s*([^\s=#\[][^=#]*)=", line)
        if header:
            place = table = _path(header[1])
        elif key:
            place = table + _path(f"{key[1]}=0")
        else:
            continue
        common = sum(1 for ours, theirs in zip(keys, place, strict=False) if ours == theirs)
        if common == min(len(keys), len(place)) and common > best:
            best, found = common, number
    return found


def _path(fragment: str) -> tuple[str, ...]:
    """Return the keys of a table's heading or of `key=0`."""
    try:
        table: Any = tomllib.loads(fragment)
    except tomllib.TOMLDecodeError:
        return ()
    keys = []
    while isinstance(table, (dict, list)) and table:
        if isinstance(table, list):
            table = table[0]
        else:
            key, table = next(iter(table.items()))
            keys.append(key)
    return tuple(keys)
