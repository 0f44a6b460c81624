"""The part of a plan that says which of the agent's metrics are kept, and which of their values:

metrics_every = 1000       # steps; 0: after each episode

[metrics]                  # any other metric is kept as it is
epsilon = 10               # every tenth value
"mean TD error" = "mean 10"  # the mean of each ten values

And which extras of the environments are recorded, one number for each episode:

[extras]
mario.coins = "last"   # of the environment with the label mario
score = "mean"         # of any environment
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Final, Literal, NamedTuple, get_args

from experiment_runner.plan.toml import SettingError, shown
from glue.console import did_you_mean

_MOST: Final = 2**31


class Keep(NamedTuple):
    """The values of a metric that are kept: the last of every `every` values, or their mean."""

    every: int = 1
    averaged: bool = False

    def __str__(self) -> str:
        return f"mean {self.every}" if self.averaged else str(self.every)


ALL: Final = Keep()


@dataclass(frozen=True, slots=True)
class MetricsPlan:
    """The recording of an agent's metrics.

    Args:
        every: steps from one reading to the next, over all episodes of a trial; 0 for one after each episode.
        keep: the values to keep of a metric, by its name; all values of any other metric.
    """

    every: int = 0
    keep: Mapping[str, Keep] = field(default_factory=dict)

    def __str__(self) -> str:
        when = f"every {self.every} steps" if self.every else "after each episode"
        return ", ".join(["recorded " + when, *(f"{name} = {keep}" for name, keep in self.keep.items())])


def parse_metrics(every: object, table: object) -> MetricsPlan | None:
    """Return the recording of metrics that a plan asks for; None if it asks for none.

    Args:
        every: `metrics_every` of the plan; None without it.
        table: `metrics` of the plan; None without it.

    Raises:
        SettingError: a value does not belong there.
    """
    if every is None and table is None:
        return None
    steps = 0 if every is None else every
    if type(steps) is not int or not 0 <= steps < _MOST:
        raise SettingError(f"metrics_every must be a number of steps, not {shown(every)}", "metrics_every")
    if not isinstance(table, dict | None):
        raise SettingError('metrics must be a table, as in: [metrics], then "mean TD error" = 10', "metrics")
    return MetricsPlan(steps, {name: _keep(name, value) for name, value in (table or {}).items()})


def _keep(name: str, value: object) -> Keep:
    if type(value) is int and 0 < value < _MOST:
        return Keep(value)
    if isinstance(value, str) and (found := re.fullmatch(r"mean ([1-9][0-9]{0,8})", value)):
        return Keep(int(found[1]), True)
    raise SettingError(
        f'metric {name!r:.80} takes a number N, which keeps every N-th value, or "mean N", '
        f"not {shown(value)}",
        "metrics",
        name,
    )


Summary = Literal["first", "last", "sum", "mean", "min", "max"]
"""The number that stands for the values of an episode."""

SUMMARIES: Final = get_args(Summary)


def parse_extras(table: object) -> dict[str, Summary]:
    """Return the summary of each extra by its name, which may follow an environment's label and a dot.

    Args:
        table: `extras` of the plan.

    Raises:
        SettingError: it is not such a table.
    """
    if not isinstance(table, dict):
        raise SettingError('extras must be a table, as in: [extras], then mario.coins = "last"', "extras")
    found: dict[str, Summary] = {}
    for name, value in table.items():
        if isinstance(value, dict):
            found |= {f"{name}.{extra}": _summary(how, name, extra) for extra, how in value.items()}
        else:
            found[name] = _summary(value, name)
    return found


def extra_of(key: str, label: str) -> str:
    """Return the name of the extra that a key means in the environment with this label."""
    return key.removeprefix(f"{label}.")


def check_extras(keys: Collection[str], labels: Iterable[str]) -> None:
    """Check that no two keys mean the same extra of one of the environments with these labels.

    Raises:
        SettingError: two do: one number is recorded of each.
    """
    for label in labels:
        meant: dict[str, str] = {}
        for key in keys:
            other = meant.get(extra_of(key, label))
            meant[extra_of(key, label)] = key
            if other is not None:
                of_label = f" of {label}" if label else ""
                raise SettingError(
                    f"{other} and {key} are the same extra{of_label}, and one number is recorded of each: "
                    "leave one out",
                    "extras",
                )


def _summary(value: object, *keys: str) -> Summary:
    if value not in SUMMARIES:
        near = did_you_mean(value if isinstance(value, str) else "", SUMMARIES)
        raise SettingError(
            f"of the extra {'.'.join(keys)!r:.80} an episode's {', '.join(SUMMARIES)} can be recorded, "
            f"not {shown(value)}{near}",
            "extras",
            *keys,
        )
    return value  # type: ignore[return-value]
