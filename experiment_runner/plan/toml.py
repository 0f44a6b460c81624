"""TOML files that a user writes: reading one, and errors that name the file, the line and near misses."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import fields
from pathlib import Path
from typing import Any, Final, TypeVar, get_args, get_type_hints

import msgspec

from glue.console import did_you_mean
from glue.errors import ExperimentError
from glue.files import read_regular

_T = TypeVar("_T")

_MAX_BYTES: Final = 2**22
_MAX_DOTS: Final = 16
"""Maximum number in a dotted key, which costs the square of it to read."""
_SHOWN: Final = 80
"""Maximum number of characters of a wrong value in a message."""

_STRING_OR_COMMENT: Final = re.compile(
    r""""{3}(?:[^"\\]|\\.|"(?!""))*+(?:"{3,5}|\\?\Z)|'{3}(?:[^']|'(?!''))*+(?:'{3,5}|\Z)"""
    r"""|"(?:[^"\\\n]|\\[^\n])*+"?|'[^'\n]*'?|#[^\n]*""",
    re.DOTALL,
)
"""Also one without an end, so that each character is looked at once."""

_WORDS: Final = {
    " | null": "",
    "Number out of range": "a number in range",
    "`int | float`": "a number",
    "`int`": "a whole number",
    "`float`": "a number",
    "`str`": "a string",
    "`bool`": "true or false",
    "`datetime`": "a time, as in 2026-12-01T09:00:00",
    "`array`": 'a list, as in ["one", "two"]',
    "`object`": "a table, as in { name = 1 }",
}
"""The types of values as msgspec's messages name them, and as people do."""


class SettingError(ExperimentError):
    """A key or a value in a user's TOML file is wrong.

    Attributes:
        keys: the key, after those of the tables that contain it; empty if the error is about no key.
    """

    def __init__(self, message: str, *keys: str) -> None:
        super().__init__(message)
        self.keys = keys

    def inside(self, *keys: str) -> SettingError:
        """Return this error for a table that is inside others."""
        return SettingError(str(self), *keys, *self.keys)


def read(path: Path, what: str, follow: bool = True) -> str:
    """Return the text of a file.

    Args:
        path: of the file.
        what: what the file describes, for messages.
        follow: whether it may be a symbolic link: the user has named it.

    Raises:
        ExperimentError: the file cannot be read, is no text or too large; the message names it.
    """
    try:
        return read_regular(path, _MAX_BYTES, follow=follow).decode()
    except OSError as error:
        raise ExperimentError(f"cannot read the {what} {path}: {error.strerror or error}") from error
    except UnicodeDecodeError as error:
        raise ExperimentError(f"cannot read the {what} {path}: it is not UTF-8 text") from error


def parse(text: str) -> dict[str, Any]:
    """Return the document of a TOML text.

    Raises:
        SettingError: the text is not TOML, or is nested too deeply.
    """
    keys_and_numbers = re.split(r"[=,\[\]{}\n]", _STRING_OR_COMMENT.sub("", text))
    try:
        if any(part.count(".") > _MAX_DOTS for part in keys_and_numbers):
            raise RecursionError
        return _loads(text)
    except RecursionError:
        raise SettingError("this TOML is nested too deeply") from None
    except ValueError as error:  # also a number of thousands of digits
        raise SettingError(f"this is not TOML: {error}") from error


def _loads(text: str) -> dict[str, Any]:
    import tomllib  # not needed to show the results of a run

    return tomllib.loads(text)


@contextmanager
def naming_lines(path: Path, text: str) -> Iterator[None]:
    """Add the file to SettingErrors of the body, and the line to an error about a key of its `text`."""
    try:
        yield
    except SettingError as error:
        line = line_of(text, error.keys) if error.keys else None
        raise ExperimentError(f"{path}{'' if line is None else f', line {line}'}: {error}") from error


def converted(
    kind: type[_T],
    table: object,
    what: str,
    /,
    *keys: str,
    base: Path = Path(),
    also: Sequence[str] = (),
    **given: object,
) -> _T:
    """Return a table as a dataclass, whose annotations say what msgspec is to allow.

    Args:
        kind: the dataclass; every field is a key of the table, except those of `given`.
        table: the table.
        what: the table in messages, as in `task easy`.
        keys: those that lead to the table.
        base: the folder that relative paths begin at.
        also: keys of the user's that the caller has taken from the table, for near misses.
        given: fields that are not the user's.

    Raises:
        SettingError: it is no table, has an unknown key, lacks one, or has a value that is not allowed or a
            string that is empty or cannot be printed.
    """
    if not isinstance(table, dict):
        raise SettingError(f"{'.'.join(keys)} must be a table, as in: [{'.'.join(keys)}]", *keys)
    known = [field.name for field in fields(kind) if field.name not in given]  # type: ignore[arg-type]
    for key, value in table.items():
        if key not in known:
            raise SettingError(f"{what} has no {key!r:.80}{did_you_mean(key, [*known, *also])}", *keys, key)
        if isinstance(value, str) and not (value and value.isprintable()):
            raise SettingError(f"{key} must be a printable string, not {shown(value)}", *keys, key)
    try:
        return msgspec.convert({**table, **given}, kind, dec_hook=lambda _, path: _path_from(base, path))
    except SettingError as error:
        raise error.inside(*keys) from None
    except msgspec.ValidationError as error:
        raise _wrong_value(str(error), table, kind, what).inside(*keys) from None


def _path_from(base: Path, path: object) -> Path:
    if not isinstance(path, str):
        raise TypeError("Expected `str`")
    return base / path


def _wrong_value(message: str, table: Mapping[str, Any], kind: type, what: str) -> SettingError:
    """Return the error for a message of msgspec, such as "Expected `int` >= 2 - at `$.pids`"."""
    message, _, place = message.partition(" - at `$")
    path = re.findall(r"\.(\w+)|\[(\d+)\]", place)
    keys = [key for key, _ in path if key]
    if "missing required field" in message:
        return SettingError(f"{what} needs {message.split('`')[1]}", *keys)
    value: Any = table
    for key, index in path:
        value = value[key] if key else value[int(index)]
    if (choices := _choices(get_type_hints(kind)[keys[0]])) and "`array`" not in message:
        near = did_you_mean(value if isinstance(value, str) else "", choices)
        return SettingError(f"{keys[0]} cannot be {shown(value)}{near}", *keys)
    expected = message.partition(", got")[0].removeprefix("Expected ")
    for word, ours in _WORDS.items():
        expected = expected.replace(word, ours)
    return SettingError(f"{place[1:-1]} must be {expected}, not {shown(value)}", *keys)


def _choices(hint: Any) -> list[str]:
    """Return the strings of the `Literal` that a type is, or is a list of."""
    return [one for part in get_args(hint) for one in ([part] if isinstance(part, str) else _choices(part))]


def is_option(value: object) -> bool:
    """Return whether a value can be an option's: a string, a bool, or a number that a float can hold."""
    return isinstance(value, bool | float | str) or (type(value) is int and value.bit_length() < 1024)


def shown(value: object) -> str:
    """Return the beginning of a value, for a message."""
    try:
        return f"{value!r:.{_SHOWN}}"
    except ValueError:
        return "a number of thousands of digits"
    except RecursionError:
        return "a value that is nested too deeply"


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
        table: Any = _loads(fragment)
    except ValueError:
        return ()
    keys = []
    while isinstance(table, (dict, list)) and table:
        if isinstance(table, list):
            table = table[0]
        else:
            key, table = next(iter(table.items()))
            keys.append(key)
    return tuple(keys)
