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

With `rate = 24`, in steps per second, no environment waits for its agent: `late = "repeat"` or
`late = "0,1"` says what is carried out while it is late. `delay = 2` carries actions out so many steps later.

`metrics_every` and a table `metrics` record the agents' own numbers: see `experiment_runner.plan.metrics`. A
table `extras` records those of the environments: see `experiment_runner.plan.metrics`.

A table `tune` searches the options of agents: see `experiment_runner.plan.tuning`.

The seed of a trial is derived from `seed` and the trial's number. `seeds = "id"` derives it from the
trial's id instead, as plans before 0.3.0 did.
"""

from __future__ import annotations

import json
import re
from dataclasses import fields
from pathlib import Path

from experiment_runner.plan.limits import BUDGETS, COUNTS, PACE
from experiment_runner.plan.metrics import parse_extras, parse_metrics
from experiment_runner.plan.plan import ROLES, Plan, RoleSweep, Seeds, plain
from experiment_runner.plan.toml import SettingError, converted, naming_lines, parse, read, shown
from experiment_runner.plan.tuning import Range, TunePlan, parse_tune
from glue.options import Value


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
    table = {"seeds": seeds, "environments": {}, "agents": {}, **parse(text)}
    metrics = parse_metrics(table.pop("metrics_every", None), table.get("metrics"))
    extras = parse_extras(table.get("extras", {}))
    tune = parse_tune(table["tune"]) if "tune" in table else None
    roles = {role: _roles(role, table[role]) for role in ROLES}
    table |= roles | {"metrics": metrics, "extras": extras, "tune": tune}
    return converted(Plan, table, "a plan", also=["metrics_every"])


def dump_plan(plan: Plan) -> str:
    """Return the plan as TOML, from which `parse_plan` returns an equal plan."""
    counts = {name: getattr(plan, name) for name in COUNTS}
    lines = [f"{name} = {count}" for name, count in counts.items() if count or name not in BUDGETS]
    if plan.pace:
        lines += [f"{name} = {_toml_value(getattr(plan, name))}" for name in PACE]
    lines.append(f"seeds = {_toml_value(plan.seeds)}")
    if plan.inside:
        lines.append(f"inside = [{', '.join(map(_toml_value, plan.inside))}]")
    if plan.metrics is not None:
        lines.append(f"metrics_every = {plan.metrics.every}")
        kept = plan.metrics.keep.items()
        lines += ["", "[metrics]"] if kept else []
        lines += [f"{_toml_key(n)} = {_toml_value(str(k) if k.averaged else k.every)}" for n, k in kept]
    if plan.extras:
        lines += ["", "[extras]", *(f"{_toml_key(n)} = {_toml_value(how)}" for n, how in plan.extras.items())]
    for role in ROLES:
        for sweep in getattr(plan, role):
            lines += ["", f"[{role}.{_toml_key(sweep.label)}]", f"class = {_toml_value(sweep.name)}"]
            lines += [f"{_toml_key(name)} = {_toml_value(value)}" for name, value in sweep.options.items()]
    if plan.tune is not None:
        lines += ["", "[tune]", *_lines(plan.tune, "agents")]
        for label, space in plan.tune.agents.items():
            lines += ["", f"[tune.agents.{_toml_key(label)}]"]
            lines += [f"{_toml_key(name)} = {_toml_value(value)}" for name, value in space.items()]
    return "\n".join(lines) + "\n"


def _lines(table: Range | TunePlan, *without: str) -> list[str]:
    """Return a line of TOML for each field of a dataclass."""
    names = [field.name for field in fields(table) if field.name not in without]
    return [f"{name} = {_toml_value(getattr(table, name))}" for name in names]


def _roles(role: str, tables: object) -> tuple[RoleSweep, ...]:
    if not isinstance(tables, dict):
        raise SettingError(f"{role} must be tables, as in: [{role}.NAME]", role)
    return tuple(_role(role, key, table) for key, table in tables.items())


def _role(role: str, key: str, table: object) -> RoleSweep:
    if not isinstance(table, dict):
        raise SettingError(f"{role}.{key} must be a table, as in: [{role}.{key}]", role, key)
    options = {name: tuple(value) if isinstance(value, list) else value for name, value in table.items()}
    name = options.pop("class", None)
    if name is not None and not isinstance(name, str):
        raise SettingError(f"class of {role}.{key} names one class, not {shown(name)}", role, key, "class")
    try:
        return RoleSweep(key, options) if name is None else RoleSweep(name, options, key)
    except SettingError as error:
        raise error.inside(role, key) from None


def _toml_key(key: str) -> str:
    return key if re.fullmatch(r"[A-Za-z0-9_-]+", key) else _toml_value(key)


def _toml_value(value: Value | tuple[Value, ...] | Range) -> str:
    if isinstance(value, Range):
        return f"{{{', '.join(_lines(value))}}}"
    if isinstance(value, tuple):
        return f"[{', '.join(map(_toml_value, value))}]"
    if isinstance(value, str):
        # JSON's escapes are valid in TOML, but TOML also requires DEL to be escaped.
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    return plain(value)
