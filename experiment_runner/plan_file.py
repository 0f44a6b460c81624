"""Reading and writing plans as TOML files:

    episodes = 5000
    trials = 10
    seed = 1

    [environments.mario]
    level_seed = 121
    level_difficulty = [0, 1]

    [agents.sample]

    [agents.hierarchical]
    step_size = [0.1, 0.3]

    [agents.textbook]
    class = "tiles"
    terminal_update = true

The heading of a table is the name of an agent or environment, or a label of your own with the name
under `class`. A list of values is swept over. Every agent meets every environment, in every
combination of the swept values, `trials` times. Omit `agents` (or `environments`) if that
role connects from outside.
"""

from __future__ import annotations

import json
import re
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from experiment_runner.plan import COUNTS, ROLES, Plan, RoleSweep, plain
from glue.errors import ExperimentError
from glue.options import Value
from glue.suggestions import did_you_mean

__all__ = ["dump_plan", "load_plan", "parse_plan"]


def load_plan(path: Path) -> Plan:
    """Return the plan in a TOML file.

    Raises:
        ExperimentError: the file cannot be read, or is not a plan; the message names the file.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise ExperimentError(f"cannot read the plan {path}: {_reason(error)}") from error
    try:
        return parse_plan(text)
    except ExperimentError as error:
        raise ExperimentError(f"{path}: {error}") from error


def parse_plan(text: str) -> Plan:
    """Return the plan that a TOML text describes.

    Raises:
        ExperimentError: it is not TOML, or a key or value does not belong in a plan.
    """
    try:
        document = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise ExperimentError(f"this is not TOML: {error}") from error
    known = (*COUNTS, *ROLES)
    for key in document:
        if key not in known:
            raise ExperimentError(f"a plan has no {key!r}{did_you_mean(key, known)}")
    if "episodes" not in document:
        raise ExperimentError("a plan needs the number of episodes of each trial, as in: episodes = 1000")
    counts = {name: document[name] for name in COUNTS if name in document}
    return Plan(
        **counts,
        environments=_parse_roles("environments", document),
        agents=_parse_roles("agents", document),
    )


def dump_plan(plan: Plan) -> str:
    """Return the plan as TOML, from which `parse_plan` returns an equal plan."""
    lines = [f"{name} = {getattr(plan, name)}" for name in COUNTS]
    for role in ROLES:
        for sweep in getattr(plan, role):
            lines += ["", f"[{role}.{_toml_key(sweep.label)}]", f"class = {_toml_value(sweep.name)}"]
            lines += [f"{_toml_key(name)} = {_toml_value(value)}" for name, value in sweep.options.items()]
    return "\n".join(lines) + "\n"


def _parse_roles(role: str, document: Mapping[str, Any]) -> tuple[RoleSweep, ...]:
    tables = document.get(role, {})
    if not isinstance(tables, dict):
        raise ExperimentError(f"{role} are written as tables, as in: [{role}.NAME]")
    return tuple(_parse_role(role, key, table) for key, table in tables.items())


def _parse_role(role: str, key: str, table: object) -> RoleSweep:
    if not isinstance(table, dict):
        raise ExperimentError(f"{role}.{key} is written as a table, as in: [{role}.{key}]")
    options: dict[str, Any] = {
        name: tuple(value) if isinstance(value, list) else value for name, value in table.items()
    }
    name = options.pop("class", None)
    if name is None:
        return RoleSweep(key, options)
    if not isinstance(name, str):
        raise ExperimentError(f"class of {role}.{key} names one class, not {name!r}")
    return RoleSweep(name, options, key)


def _toml_key(key: str) -> str:
    return key if re.fullmatch(r"[A-Za-z0-9_-]+", key) else _toml_value(key)


def _toml_value(value: Value | tuple[Value, ...]) -> str:
    if isinstance(value, tuple):
        return f"[{', '.join(map(_toml_value, value))}]"
    if isinstance(value, str):
        # JSON's escapes are TOML's, but TOML also wants DEL escaped.
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    return plain(value)


def _reason(error: OSError | UnicodeDecodeError) -> str:
    return (error.strerror or str(error)) if isinstance(error, OSError) else "it is not UTF-8 text"
