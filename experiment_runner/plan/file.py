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
from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any, Final

from experiment_runner.plan.metrics import parse_metrics
from experiment_runner.plan.plan import BUDGETS, COUNTS, ROLES, Plan, RoleSweep, Seeds, plain
from experiment_runner.plan.toml import SettingError, check_keys, naming_lines, parse, read, shown
from experiment_runner.plan.tuning import Range, parse_tune, tune_tables
from glue.options import Value

_KEYS: Final = (*COUNTS, "seeds", "inside", "metrics_every", "metrics", "tune", *ROLES)


def load_plan(path: Path, seeds: Seeds = "number", *, follow: bool = True) -> Plan:
    """Return the plan in a TOML file.

    Args:
        path: of the file.
        seeds: derivation of the seeds if the plan names none.

    Raises:
        ExperimentError: the file cannot be read, or is not a plan; the message names the file.
    """
    text = read(path, "plan", follow)
    with naming_lines(path, text):
        return parse_plan(text, seeds)


def parse_plan(text: str, seeds: Seeds = "number") -> Plan:
    """Return the plan that a TOML text describes; `seeds` as in `load_plan`.

    Raises:
        SettingError: it is not TOML, or a key or value does not belong in a plan.
    """
    document = parse(text)
    check_keys(document, _KEYS, "a plan")
    counts = {name: document[name] for name in COUNTS if name in document}
    inside = document.get("inside", [])
    if not isinstance(inside, list):
        raise SettingError('inside is a list of players, as in: inside = ["env"]', "inside")
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
        raise SettingError(f"{role} are written as tables, as in: [{role}.NAME]", role)
    return tuple(_parse_role(role, key, table) for key, table in tables.items())


def _parse_role(role: str, key: str, table: object) -> RoleSweep:
    if not isinstance(table, dict):
        raise SettingError(f"{role}.{key} is written as a table, as in: [{role}.{key}]", role, key)
    options: dict[str, Any] = {
        name: tuple(value) if isinstance(value, list) else value for name, value in table.items()
    }
    name = options.pop("class", None)
    if name is not None and not isinstance(name, str):
        raise SettingError(f"class of {role}.{key} names one class, not {shown(name)}", role, key, "class")
    try:
        return RoleSweep(key, options) if name is None else RoleSweep(name, options, key)
    except SettingError as error:
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
