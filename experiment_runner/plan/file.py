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
under `class`. A list of values is swept over. Every agent plays every environment, in every
combination of the swept values, `trials` times. Omit `agents` (or `environments`) if that
role connects from outside.

In place of `episodes`, `steps = 100000` gives each trial a budget of steps, which cuts off its last episode.

`metrics_every` and a table `metrics` record the agents' own numbers: see `experiment_runner.plan.metrics`.

A table `tune` searches the options of agents: see `experiment_runner.plan.tuning`.

The seed of a trial is derived from `seed` and the trial's number. `seeds = "id"` derives it from the
trial's id instead, as plans before 0.3.0 did.
"""

from __future__ import annotations

import json
import re
import tomllib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import fields
from pathlib import Path
from typing import Any, Final

from experiment_runner.plan.lines import PlanError, line_of
from experiment_runner.plan.metrics import parse_metrics
from experiment_runner.plan.plan import BUDGETS, COUNTS, ROLES, Plan, RoleSweep, Seeds, plain
from experiment_runner.plan.tuning import Range, parse_tune, tune_tables
from glue.errors import ExperimentError
from glue.options import Value
from glue.suggestions import did_you_mean

_MAX_BYTES: Final = 2**22


def load_plan(path: Path, seeds: Seeds = "number") -> Plan:
    """Return the plan in a TOML file.

    Args:
        path: of the file.
        seeds: derivation of the seeds if the plan names none.

    Raises:
        ExperimentError: the file cannot be read, or is not a plan; the message names the file.
    """
    try:
        with path.open("rb") as file:
            text = file.read(_MAX_BYTES + 1).decode()
    except (OSError, UnicodeDecodeError) as error:
        raise ExperimentError(f"cannot read the plan {path}: {_reason(error)}") from error
    with naming_lines(path):
        if len(text) > _MAX_BYTES:
            raise PlanError(f"a plan has at most {_MAX_BYTES:,} bytes")
        return parse_plan(text, seeds)


@contextmanager
def naming_lines(path: Path) -> Iterator[None]:
    """Add the file of a plan to errors of the body, and the line to an error about a key."""
    try:
        yield
    except PlanError as error:
        line = line_of(path.read_text(encoding="utf-8"), error.keys) if error.keys else None
        raise ExperimentError(f"{path}{'' if line is None else f', line {line}'}: {error}") from error


def parse_plan(text: str, seeds: Seeds = "number") -> Plan:
    """Return the plan that a TOML text describes; `seeds` as in `load_plan`.

    Raises:
        PlanError: it is not TOML, or a key or value does not belong in a plan.
    """
    try:
        return _plan_of(tomllib.loads(text), seeds)
    except RecursionError:
        raise PlanError("this is not a plan: it is nested too deeply") from None
    except ValueError as error:  # also a number of thousands of digits
        raise PlanError(f"this is not TOML: {error}") from error


def _plan_of(document: Mapping[str, Any], seeds: Seeds) -> Plan:
    known = (*COUNTS, "seeds", "inside", "metrics_every", "metrics", "tune", *ROLES)
    for key in document:
        if key not in known:
            raise PlanError(f"a plan has no {key!r}{did_you_mean(key, known)}", key)
    counts = {name: document[name] for name in COUNTS if name in document}
    inside = document.get("inside", [])
    if not isinstance(inside, list):
        raise PlanError('inside is a list of players, as in: inside = ["env"]', "inside")
    return Plan(
        **counts,
        environments=_parse_roles("environments", document),
        agents=_parse_roles("agents", document),
        seeds=document.get("seeds", seeds),
        inside=tuple(inside),
        metrics=parse_metrics(document.get("metrics_every"), document.get("metrics")),
        tune=parse_tune(document["tune"]) if "tune" in document else None,
    )


def dump_plan(plan: Plan) -> str:
    """Return the plan as TOML, from which `parse_plan` returns an equal plan."""
    counts = {name: getattr(plan, name) for name in COUNTS}
    lines = [f"{name} = {count}" for name, count in counts.items() if count or name not in BUDGETS]
    lines.append(f"seeds = {_toml_value(plan.seeds)}")
    if plan.inside:
        lines.append(f"inside = [{', '.join(map(_toml_value, plan.inside))}]")
    if plan.metrics is not None:
        lines.append(f"metrics_every = {plan.metrics.every}")
        kept = plan.metrics.keep.items()
        lines += ["", "[metrics]"] if kept else []
        lines += [f"{_toml_key(n)} = {_toml_value(str(k) if k.averaged else k.every)}" for n, k in kept]
    for role in ROLES:
        for sweep in getattr(plan, role):
            lines += ["", f"[{role}.{_toml_key(sweep.label)}]", f"class = {_toml_value(sweep.name)}"]
            lines += [f"{_toml_key(name)} = {_toml_value(value)}" for name, value in sweep.options.items()]
    for label, table in (tune_tables(plan.tune) if plan.tune else {}).items():
        lines += ["", f"[tune.agents.{_toml_key(label)}]" if label else "[tune]"]
        lines += [f"{_toml_key(name)} = {_tune_value(value)}" for name, value in table.items()]
    return "\n".join(lines) + "\n"


def _tune_value(value: Any) -> str:
    if not isinstance(value, Range):
        return _toml_value(value)
    ends = [f"{one.name} = {_toml_value(getattr(value, one.name))}" for one in fields(Range)]
    return f"{{{', '.join(ends)}}}"


def _parse_roles(role: str, document: Mapping[str, Any]) -> tuple[RoleSweep, ...]:
    tables = document.get(role, {})
    if not isinstance(tables, dict):
        raise PlanError(f"{role} are written as tables, as in: [{role}.NAME]", role)
    return tuple(_parse_role(role, key, table) for key, table in tables.items())


def _parse_role(role: str, key: str, table: object) -> RoleSweep:
    if not isinstance(table, dict):
        raise PlanError(f"{role}.{key} is written as a table, as in: [{role}.{key}]", role, key)
    options: dict[str, Any] = {
        name: tuple(value) if isinstance(value, list) else value for name, value in table.items()
    }
    name = options.pop("class", None)
    if name is not None and not isinstance(name, str):
        raise PlanError(f"class of {role}.{key} names one class, not {name!r}", role, key, "class")
    try:
        return RoleSweep(key, options) if name is None else RoleSweep(name, options, key)
    except PlanError as error:
        raise error.inside(role, key) from None


def _toml_key(key: str) -> str:
    return key if re.fullmatch(r"[A-Za-z0-9_-]+", key) else _toml_value(key)


def _toml_value(value: Value | tuple[Value, ...]) -> str:
    if isinstance(value, tuple):
        return f"[{', '.join(map(_toml_value, value))}]"
    if isinstance(value, str):
        # JSON's escapes are valid in TOML, but TOML also requires DEL to be escaped.
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    return plain(value)


def _reason(error: OSError | UnicodeDecodeError) -> str:
    return (error.strerror or str(error)) if isinstance(error, OSError) else "it is not UTF-8 text"
