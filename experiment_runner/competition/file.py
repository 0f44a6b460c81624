"""Reading a competition from its TOML file; docs/competition.md describes it."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any, Final

from experiment_runner.competition.settings import Competition, Entrant, Limits, Task
from experiment_runner.plan.toml import (
    SettingError,
    check_keys,
    is_option,
    naming_lines,
    parse,
    read,
    shown,
    whole,
)
from glue.errors import ConfigError, ExperimentError
from glue.hub.config import TimeLimits
from glue.plugins.loading import located

_TOP: Final = ("name", "trials", "seed_file", "seed_env", "limits", "tasks", "entrants")
_TASK: Final = ("env", "options", "episodes", "steps", "max_steps")
_ENTRANT: Final = ("image", "command", "key", "folder")
_TIMES: Final = tuple(field.name for field in fields(TimeLimits))
_SIZES: Final = ("memory", "tmp", "shm", "log")
_LIMITS: Final = (*_TIMES, *_SIZES, "cpus", "pids")

_NAME: Final = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.+-]{0,63}")
_SIZE: Final = re.compile(r"(\d{1,12})([kmg]?)")
_UNITS: Final = {"": 1, "k": 2**10, "m": 2**20, "g": 2**30}
_COUNT: Final = range(1, 2**31)
_TRIALS: Final = range(1, 1001)
_MAX_STEPS: Final = range(2, 2**31)  # RL_num_steps is 1 before the first step
_PIDS: Final = range(2, 2**22)  # a container has an init besides the program
_LEAST_MEMORY: Final = 6 * 2**20  # of Docker's containers
_LEAST_CPUS: Final = 0.01  # likewise


def load_competition(path: Path, *, follow: bool = True) -> Competition:
    """Return the competition that a TOML file describes.

    Raises:
        ConfigError: the file cannot be read or describes no competition; the message names file and line.
    """
    try:
        text = read(path, "competition", follow)
    except ExperimentError as error:
        raise ConfigError(str(error)) from error
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
        with naming_lines(path, text):
            return _competition(parse(text), path)
    except ExperimentError as error:
        raise ConfigError(str(error)) from error


def _competition(document: Mapping[str, Any], path: Path) -> Competition:
    check_keys(document, _TOP, "a competition")
    folder = path.parent
    tasks = tuple(_task(name, table, folder) for name, table in _tables(document, "tasks").items())
    entrants = tuple(_entrant(name, table, folder) for name, table in _tables(document, "entrants").items())
    if ("seed_file" in document) == ("seed_env" in document):
        raise SettingError(
            'name the secret from which levels are drawn, once: seed_file = "secret.txt", '
            'or seed_env = "COMPETITION_SEED"',
            "seed_env",
        )
    seed_file = _text(document, "seed_file")
    return Competition(
        _text(document, "name") or path.stem,
        _whole(document, "trials", _TRIALS, 1),
        tasks,
        entrants,
        _limits(document.get("limits", {})),
        None if seed_file is None else folder / seed_file,
        _text(document, "seed_env"),
    )


def _tables(document: Mapping[str, Any], kind: str) -> Mapping[str, Mapping[str, Any]]:
    """Return the tables of the tasks or the entrants, by name."""
    tables = document.get(kind)
    if not isinstance(tables, dict) or not tables:
        raise SettingError(f"a competition needs {kind}, each a table, as in: [{kind}.NAME]", kind)
    for name, table in tables.items():
        if not _NAME.fullmatch(name):
            raise SettingError(
                f"{name!r} cannot be a name: up to 64 letters, digits and _ . + - are allowed, and the "
                "first is a letter, a digit or _",
                kind,
                name,
            )
        if not isinstance(table, dict):
            raise SettingError(f"{kind}.{name} must be a table, as in: [{kind}.{name}]", kind, name)
    return tables


def _task(name: str, table: Mapping[str, Any], folder: Path) -> Task:
    where = ("tasks", name)
    check_keys(table, _TASK, f"task {name}", *where)
    if "env" not in table:
        raise SettingError(f'task {name} needs an environment, as in: env = "mario"', *where)
    if ("episodes" in table) == ("steps" in table):
        raise SettingError(f"task {name} needs its length: episodes = 20, or steps = 100_000", *where)
    options = table.get("options", {})
    if not isinstance(options, dict):
        example = "options = { level_difficulty = 0 }"
        raise SettingError(f"options must be a table, as in: {example}", *where, "options")
    for option, value in options.items():
        if not is_option(value):
            raise SettingError(
                f"option {option!r:.80} takes a number, a string, true or false, not {shown(value)}",
                *where,
                "options",
                option,
            )
    return Task(
        name,
        located(_text(table, "env", *where) or "", folder),
        options,
        _whole(table, "episodes", _COUNT, 0, *where),
        _whole(table, "steps", _COUNT, 0, *where),
        _whole(table, "max_steps", _MAX_STEPS, 0, *where),
    )


def _entrant(name: str, table: Mapping[str, Any], folder: Path) -> Entrant:
    where = ("entrants", name)
    check_keys(table, _ENTRANT, f"entrant {name}", *where)
    if len(table) != 1:
        raise SettingError(
            f'entrant {name} needs one of image = "alice/agent:1", command = ["glue-agent", "sample"], '
            'key = "carol.pub" and folder = "/run/entrants/dave"',
            *where,
        )
    command = table.get("command", [])
    if not isinstance(command, list) or not all(isinstance(part, str) for part in command):
        raise SettingError(
            f'command is a list of strings, as in: ["glue-agent", "sample"]; not {shown(command)}',
            *where,
            "command",
        )
    if "command" in table and not command:
        raise SettingError(f"the command of {name} is empty", *where, "command")
    key, socket_folder = (_text(table, field, *where) for field in ("key", "folder"))
    return Entrant(
        name,
        _text(table, "image", *where),
        tuple(command),
        None if key is None else folder / key,
        None if socket_folder is None else folder / socket_folder,
    )


def _limits(table: Any) -> Limits:
    if not isinstance(table, dict):
        raise SettingError("limits must be a table, as in: [limits]", "limits")
    check_keys(table, _LIMITS, "[limits]", "limits")
    given: dict[str, Any] = {}
    for key, value in table.items():
        if key in _SIZES:
            given[key] = _size(key, value)
        elif key == "pids":
            given[key] = _whole(table, key, _PIDS, 0, "limits")
        else:
            number = type(value) is float or (type(value) is int and abs(value) < _COUNT.stop)
            if not number or (key == "cpus" and not _LEAST_CPUS <= value <= 1024):
                least = f" of at least {_LEAST_CPUS:g}" if key == "cpus" else ""
                raise SettingError(f"{key} must be a number{least}, not {shown(value)}", "limits", key)
            given[key] = float(value)
    times = {key: given.pop(key) for key in _TIMES if key in given}
    try:
        return Limits(time=TimeLimits(**times), **given)
    except ConfigError as error:
        wrong = next((key for key in times if key in str(error)), "")
        raise SettingError(str(error), "limits", wrong) from error


def _size(key: str, value: object) -> int:
    text = str(value) if isinstance(value, str) or (type(value) is int and 0 < value < 2**62) else ""
    match = _SIZE.fullmatch(text.lower())
    if match is None or not int(match[1]):
        raise SettingError(
            f'{key} is a number of bytes, as in: {key} = "512m"; not {shown(value)}', "limits", key
        )
    size = int(match[1]) * _UNITS[match[2]]
    if key == "memory" and size < _LEAST_MEMORY:
        raise SettingError(f'{key} must be at least "6m", not {shown(value)}', "limits", key)
    return size


def _text(table: Mapping[str, Any], key: str, *where: str) -> str | None:
    value = table.get(key)
    if value is not None and not (isinstance(value, str) and value and value.isprintable()):
        raise SettingError(f"{key} must be a printable string, not {shown(value)}", *where, key)
    return value


def _whole(table: Mapping[str, Any], key: str, allowed: range, default: int, *where: str) -> int:
    return whole(table[key], allowed, key, *where, key) if key in table else default
