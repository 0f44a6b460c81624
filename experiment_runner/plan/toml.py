"""TOML files that a user writes: reading one, and errors that name the file, the line and near misses."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final, TypeVar

import msgspec

from glue.errors import ExperimentError
from glue.files import read_regular
from glue.suggestions import did_you_mean

_MAX_BYTES: Final = 2**22
_SHOWN: Final = 80
"""Maximum number of characters of a wrong value in a message."""


_T = TypeVar("_T")

_WORDS: Final = {
    "BoolType": "true or false",
    "IntType": "a whole number",
    "FloatType": "a number",
    "StrType": "a string",
    **dict.fromkeys(("ListType", "VarTupleType"), "a list"),
    **dict.fromkeys(("DictType", "StructType", "DataclassType"), "a table"),
}
"""What a value is called in messages, by the name of msgspec's description of its type."""


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
    try:
        return tomllib.loads(text)
    except RecursionError:
        raise SettingError("this TOML is nested too deeply") from None
    except ValueError as error:  # also a number of thousands of digits
        raise SettingError(f"this is not TOML: {error}") from error


@contextmanager
def naming_lines(path: Path, text: str) -> Iterator[None]:
    """Add the file to SettingErrors of the body, and the line to an error about a key of its `text`."""
    try:
        yield
    except SettingError as error:
        line = line_of(text, error.keys) if error.keys else None
        raise ExperimentError(f"{path}{'' if line is None else f', line {line}'}: {error}") from error


def check_keys(table: Mapping[str, Any], known: Collection[str], what: str, *where: str) -> None:
    """Check that a table has only known keys.

    Raises:
        SettingError: it has another; the message suggests near misses.
    """
    for key in table:
        if key not in known:
            raise SettingError(f"{what} has no {key!r:.80}{did_you_mean(key, known)}", *where, key)


def fitted(table: object, kind: type[_T], what: str, *where: str) -> _T:
    """Return a table of a document as a `kind`.

    Args:
        table: the table; it is of no use after an error.
        kind: a `msgspec.Struct` that forbids unknown fields, or anything else that msgspec converts to. A
            ValueError of its `__post_init__` is an error of that table.
        what: names the table in messages, as in `a plan`.
        where: its keys, if it is in other tables.

    Raises:
        SettingError: the table does not fit; the message names the key and what belongs there.
    """
    try:
        return msgspec.convert(table, kind)
    except msgspec.ValidationError as error:
        fault = str(error)
    except ValueError:  # msgspec would print it
        raise SettingError(f"{what} has a number of thousands of digits", *where) from None
    from msgspec import inspect  # slow to import

    found = re.fullmatch(r"(.*) - at `\$(.*)`", fault, re.DOTALL)
    reason, path = found.groups() if found else (fault, "")
    keys = list(where)
    name = ""
    value: Any = table
    shape = inspect.type_info(kind)
    for name, index in re.findall(r"\.(\w+)|\[(\d+|\.{3})\]", path):
        if index == "...":
            name = _keep_culprit(value, table, kind, fault)
        if name:
            keys.append(name)
        value, shape = value[name or int(index)], _part(shape, name)
    about = ".".join(keys) or what
    if field := re.fullmatch(r"Object contains unknown field `(.*)`", reason, re.DOTALL):
        known = [each.encode_name for one in _kinds(shape) for each in getattr(one, "fields", ())]
        raise SettingError(f"{about} has no {field[1]!r:.80}{did_you_mean(field[1], known)}", *keys, field[1])
    if field := re.fullmatch(r"Object missing required field `(.*)`", reason):
        raise SettingError(f"{about} needs {field[1]}", *keys)
    if reason.startswith(("Expected", "Invalid enum")):
        words = dict.fromkeys(map(_described, _kinds(shape)))
        if "a number" in words:
            words.pop("a whole number", None)
        example = f", as in: [{about}]" if [*words] == ["a table"] else ""
        subject = f"each value of {about}" if path.endswith("]") and not name else about
        raise SettingError(f"{subject} must be {' or '.join(words)}{example}, not {shown(value)}", *keys)
    raise SettingError(f"{about}: {reason}", *keys)


def _keep_culprit(inner: dict[str, Any], table: object, kind: object, fault: str) -> str:
    """Return the key of a value of which msgspec says `fault`, without its key; all others are removed."""
    values = dict(inner)
    names = [*values]
    while len(names) > 1:
        half, rest = names[: len(names) // 2], names[len(names) // 2 :]
        inner.clear()
        inner.update({name: values[name] for name in half})
        try:
            msgspec.convert(table, kind)
            names = rest
        except ValueError as error:
            names = half if str(error) == fault else rest
    inner.clear()
    inner[names[0]] = values[names[0]]
    return names[0]


def _kinds(shape: Any) -> tuple[Any, ...]:
    """Return the members of a union, or the only kind; TOML has no null."""
    kinds = getattr(shape, "types", (shape,))
    return tuple(one for one in kinds if type(one).__name__ != "NoneType")


def _part(shape: Any, name: str) -> Any:
    """Return the shape of a value of a table, or, without a name, of a list."""
    for one in _kinds(shape):
        for field in getattr(one, "fields", ()):
            if field.encode_name == name:
                return field.type
        part = getattr(one, "value_type" if name else "item_type", None)
        if part is not None:
            return part
    raise AssertionError(shape)


def _described(kind: Any) -> str:
    """Return what a value must be, as in `a whole number from 1 to 9`."""
    if hasattr(kind, "values"):
        return f"one of {', '.join(kind.values)}"
    text = _WORDS[type(kind).__name__]
    low, high = getattr(kind, "ge", None), getattr(kind, "le", None)
    if low is not None:
        text += f" of at least {low}" if high is None else f" from {low} to {high}"
    return f"{text} that is not empty" if getattr(kind, "min_length", None) else text


def whole(value: object, allowed: range, what: str, *keys: str) -> int:
    """Return a value, if it is a whole number from a range.

    Raises:
        SettingError: it is not.
    """
    if type(value) is not int or value not in allowed:
        span = f"from {allowed[0]} to {allowed[-1]}"
        raise SettingError(f"{what} must be a whole number {span}, not {shown(value)}", *keys)
    return value


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
