"""Reading a competition from its TOML file; docs/competition.md describes it.

A mistake is reported with its line: parsing loses TOML's own positions, so `line_of` searches the text for
the key.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Collection, Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any, Final, NoReturn

from experiment_runner.competition.settings import Competition, Entrant, Limits, Task
from experiment_runner.plan.lines import line_of
from glue.errors import ConfigError
from glue.hub.config import TimeLimits
from glue.plugins.loading import located
from glue.suggestions import did_you_mean

_TOP: Final = ("name", "trials", "seed_file", "seed_env", "limits", "tasks", "entrants")
_TASK: Final = ("env", "options", "episodes", "steps")
_ENTRANT: Final = ("image", "command", "key", "folder")
_TIMES: Final = tuple(field.name for field in fields(TimeLimits))
_SIZES: Final = ("memory", "tmp", "shm", "log")
_LIMITS: Final = (*_TIMES, *_SIZES, "cpus", "pids")

_NAME: Final = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.+-]{0,63}")
_SIZE: Final = re.compile(r"(\d{1,12})([kmg]?)")
_UNITS: Final = {"": 1, "k": 2**10, "m": 2**20, "g": 2**30}
_MOST_BYTES: Final = 2**20
_COUNT: Final = range(1, 2**31)
_TRIALS: Final = range(1, 1001)


def load_competition(path: Path) -> Competition:
    """Return the competition that a TOML file describes.

    Raises:
        ConfigError: the file cannot be read or describes no competition; the message names file and line.
    """
    try:
        with path.open("rb") as file:
            content = file.read(_MOST_BYTES + 1)
        text = content.decode()
    except OSError as error:
        raise ConfigError(f"cannot read the competition {path}: {error.strerror or error}") from error
    except UnicodeDecodeError as error:
        raise ConfigError(f"cannot read the competition {path}: it is not UTF-8 text") from error
    if len(content) > _MOST_BYTES:
        raise ConfigError(f"cannot read the competition {path}: it has more than {_MOST_BYTES} bytes")
    return parse_competition(text, path)


def parse_competition(text: str, path: Path) -> Competition:
    """Return the competition that a TOML text describes.

    Args:
        text: of the file.
        path: of the file, for messages; other files are relative to its folder.

    Raises:
        ConfigError: it describes no competition; the message names file and line.
    """
    try:
        document = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise ConfigError(f"{path}: this is not TOML: {error}") from error
    except (ValueError, RecursionError) as error:  # a number of thousands of digits, or deep nesting
        raise ConfigError(f"{path}: this TOML cannot be read: {error}") from error
    return _Parser(text, path).competition(document)


class _Parser:
    def __init__(self, text: str, path: Path) -> None:
        self._text = text
        self._path = path

    def competition(self, document: Mapping[str, Any]) -> Competition:
        self._keys(document, _TOP, "a competition")
        tasks = tuple(
            self._task(name, self._table(document, "tasks", name)) for name in self._names(document, "tasks")
        )
        entrants = tuple(
            self._entrant(name, self._table(document, "entrants", name))
            for name in self._names(document, "entrants")
        )
        if ("seed_file" in document) == ("seed_env" in document):
            self._fail(
                'name the secret from which levels are drawn, once: seed_file = "secret.txt", '
                'or seed_env = "COMPETITION_SEED"',
                "seed_env",
            )
        seed_file = self._text_of(document, "seed_file")
        return Competition(
            self._text_of(document, "name") or self._path.stem,
            self._whole(document, _TRIALS, "trials", default=1),
            tasks,
            entrants,
            self._limits(document.get("limits", {})),
            None if seed_file is None else self._path.parent / seed_file,
            self._text_of(document, "seed_env"),
        )

    def _names(self, document: Mapping[str, Any], kind: str) -> Collection[str]:
        tables = document.get(kind)
        if not isinstance(tables, dict) or not tables:
            self._fail(f"a competition needs {kind}, each a table, as in: [{kind}.NAME]", kind)
        for name in tables:
            if not _NAME.fullmatch(name):
                self._fail(
                    f"{name!r} cannot be a name: up to 64 letters, digits and _ . + - are allowed, and the "
                    "first is a letter, a digit or _",
                    kind,
                    name,
                )
        return tables

    def _table(self, document: Mapping[str, Any], *keys: str) -> Mapping[str, Any]:
        table: Any = document
        for key in keys:
            table = table[key]
        if not isinstance(table, dict):
            self._fail(f"{'.'.join(keys)} must be a table, as in: [{'.'.join(keys)}]", *keys)
        return table

    def _task(self, name: str, table: Mapping[str, Any]) -> Task:
        where = ("tasks", name)
        self._keys(table, _TASK, f"task {name}", *where)
        if "env" not in table:
            self._fail(f'task {name} needs an environment, as in: env = "mario"', *where)
        if ("episodes" in table) == ("steps" in table):
            self._fail(f"task {name} needs its length: episodes = 20, or steps = 100_000", *where)
        options = table.get("options", {})
        if not isinstance(options, dict):
            self._fail(
                "options must be a table, as in: options = { level_difficulty = 0 }", *where, "options"
            )
        for option, value in options.items():
            if not isinstance(value, (bool, int, float, str)):
                self._fail(
                    f"option {option} takes a number, a string, true or false, not {_shown(value)}",
                    *where,
                    "options",
                    option,
                )
        return Task(
            name,
            located(self._text_of(table, "env", *where) or "", self._path.parent),
            options,
            self._whole(table, _COUNT, "episodes", *where),
            self._whole(table, _COUNT, "steps", *where),
        )

    def _entrant(self, name: str, table: Mapping[str, Any]) -> Entrant:
        where = ("entrants", name)
        self._keys(table, _ENTRANT, f"entrant {name}", *where)
        if len(table) != 1:
            self._fail(
                f'entrant {name} needs one of image = "alice/agent:1", command = ["glue-agent", "sample"], '
                'key = "carol.pub" and folder = "/run/entrants/dave"',
                *where,
            )
        command = table.get("command", [])
        if not isinstance(command, list) or not all(isinstance(part, str) for part in command):
            self._fail(
                f'command is a list of strings, as in: ["glue-agent", "sample"]; not {_shown(command)}',
                *where,
                "command",
            )
        if "command" in table and not command:
            self._fail(f"the command of {name} is empty", *where, "command")
        key, folder = (self._text_of(table, field, *where) for field in ("key", "folder"))
        return Entrant(
            name,
            self._text_of(table, "image", *where),
            tuple(command),
            None if key is None else self._path.parent / key,
            None if folder is None else self._path.parent / folder,
        )

    def _limits(self, table: Any) -> Limits:
        if not isinstance(table, dict):
            self._fail("limits must be a table, as in: [limits]", "limits")
        self._keys(table, _LIMITS, "[limits]", "limits")
        given: dict[str, Any] = {}
        for key, value in table.items():
            if key in _SIZES:
                given[key] = self._size(key, value)
            elif key == "pids":
                given[key] = self._whole(table, range(1, 2**22), key, "limits")
            else:
                number = type(value) is float or (type(value) is int and abs(value) < _COUNT.stop)
                if not number or (key == "cpus" and not 0 < value <= 1024):
                    self._fail(
                        f"{key} must be a number{' above 0' * (key == 'cpus')}, not {_shown(value)}",
                        "limits",
                        key,
                    )
                given[key] = float(value)
        times = {key: given.pop(key) for key in _TIMES if key in given}
        try:
            return Limits(time=TimeLimits(**times), **given)
        except ConfigError as error:
            self._fail(str(error), "limits", next((key for key in times if key in str(error)), ""))

    def _size(self, key: str, value: object) -> int:
        match = _SIZE.fullmatch(str(value).lower()) if type(value) in (int, str) else None
        if match is None or not int(match[1]):
            self._fail(
                f'{key} is a number of bytes, as in: {key} = "512m"; not {_shown(value)}', "limits", key
            )
        return int(match[1]) * _UNITS[match[2]]

    def _text_of(self, table: Mapping[str, Any], key: str, *where: str) -> str | None:
        value = table.get(key)
        if value is not None and not (isinstance(value, str) and value and value.isprintable()):
            self._fail(f"{key} must be a printable string, not {_shown(value)}", *where, key)
        return value

    def _whole(
        self, table: Mapping[str, Any], allowed: range, key: str, *where: str, default: int = 0
    ) -> int:
        value = table.get(key, default)
        if key in table and (type(value) is not int or value not in allowed):
            self._fail(
                f"{key} must be a whole number from {allowed[0]} to {allowed[-1]}, not {_shown(value)}",
                *where,
                key,
            )
        return int(value)

    def _keys(self, table: Mapping[str, Any], known: Collection[str], what: str, *where: str) -> None:
        for key in table:
            if key not in known:
                self._fail(f"{what} has no {key!r}{did_you_mean(key, known)}", *where, key)

    def _fail(self, why: str, *keys: str) -> NoReturn:
        line = line_of(self._text, keys)
        where = "" if line is None else f", line {line}"
        raise ConfigError(f"{self._path}{where}: {why}")


def _shown(value: object) -> str:
    """Return the beginning of a value, for a message."""
    try:
        return f"{value!r:.60}"
    except ValueError:
        return "a number of thousands of digits"
