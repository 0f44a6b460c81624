"""The search for the options of a plan's agents: its table `tune`.

    [tune]
    sampler = "random"       # or "grid", or "optuna"
    configurations = 20      # of each agent
    trials = 3               # of each configuration
    final = 10               # of the chosen one, with other seeds
    prune = true             # give up the worse half after a quarter of each trial

    [tune.agents.sarsa]
    step_size = {low = 0.01, high = 1.0, log = true}
    epsilon = [0.05, 0.1, 0.2]

A range of whole numbers has `integer = true`; in a grid, a range has as many values as its `points`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import Any, Final

from experiment_runner.plan.toml import SettingError, check_keys, is_option, shown, whole
from glue.options import Value
from glue.suggestions import did_you_mean

SAMPLERS: Final = ("random", "grid", "optuna")
_COUNT: Final = range(1, 1_000_001)
_POINTS: Final = range(2, 1_000_001)


@dataclass(frozen=True, slots=True)
class Range:
    """The values of an option from `low` to `high`, inclusive.

    Args:
        low, high: the ends.
        log: whether the logarithms of the values are spaced or drawn evenly.
        integer: whether the values are whole numbers.
        points: number of values in a grid.

    Raises:
        SettingError: the ends are in the wrong order, or cannot have logarithms.
    """

    low: float
    high: float
    log: bool = False
    integer: bool = False
    points: int = 5

    def __post_init__(self) -> None:
        known = is_option(self.low) and is_option(self.high)
        if not (known and self.low < self.high) or (self.log and self.low <= 0):
            raise SettingError(
                f"a range is from low to a greater high{', above 0' if self.log else ''}, "
                f"not from {shown(self.low)} to {shown(self.high)}"
            )
        whole(self.points, _POINTS, "points of a range")

    def at(self, share: float) -> Value:
        """Return the value at a share, 0 to 1, of the way from low to high."""
        if self.log:
            value = float(self.low * (self.high / self.low) ** share)
        else:
            value = float(self.low + (self.high - self.low) * share)
        value = min(max(value, self.low), self.high)
        return round(value) if self.integer else value


Space = Mapping[str, Range | tuple[Value, ...]]
"""The values of an agent's options that are searched, by option."""


@dataclass(frozen=True, slots=True)
class TunePlan:
    """A search for the options of agents.

    Args:
        space: the values of each agent's options, by its label.
        sampler: the method that chooses configurations, of `SAMPLERS`.
        configurations: of each agent; a grid may have fewer.
        trials: of each configuration.
        final: trials of the chosen configuration, with seeds that the search has not used.
        prune: whether the worse half of the configurations is pruned after a quarter of each trial.

    Raises:
        SettingError: a number is out of range, or the sampler is unknown.
    """

    space: Mapping[str, Space] = field(default_factory=dict)
    sampler: str = "random"
    configurations: int = 20
    trials: int = 3
    final: int = 10
    prune: bool = False

    def __post_init__(self) -> None:
        if self.sampler not in SAMPLERS:
            near = did_you_mean(str(self.sampler), SAMPLERS)
            raise SettingError(f"there is no sampler {shown(self.sampler)}{near}", "tune", "sampler")
        for name in ("configurations", "trials", "final"):
            whole(getattr(self, name), _COUNT, f"{name} of tune", "tune", name)
        if type(self.prune) is not bool:
            raise SettingError(f"prune of tune is true or false, not {shown(self.prune)}", "tune", "prune")
        if not self.space:
            raise SettingError("tune needs the options to search, as in: [tune.agents.NAME]", "tune")


def parse_tune(table: object) -> TunePlan:
    """Return the search that the table `tune` of a plan describes.

    Raises:
        SettingError: a key or value does not belong there.
    """
    if not isinstance(table, dict):
        raise SettingError("tune is written as a table, as in: [tune]", "tune")
    given = dict(table)
    agents = given.pop("agents", {})
    check_keys(given, [one.name for one in fields(TunePlan) if one.name != "space"], "tune", "tune")
    if not isinstance(agents, dict) or not all(isinstance(space, dict) for space in agents.values()):
        raise SettingError(
            "the options to search are written as tables, as in: [tune.agents.NAME]", "tune", "agents"
        )
    return TunePlan({label: _space(label, space) for label, space in agents.items()}, **given)


def _space(label: str, table: Mapping[str, Any]) -> Space:
    found: dict[str, Range | tuple[Value, ...]] = {}
    for name, value in table.items():
        where, keys = f"{name} of tune.agents.{label}", ("tune", "agents", label, name)
        if isinstance(value, list) and value and all(map(is_option, value)):
            found[name] = tuple(value)
        elif isinstance(value, dict):
            check_keys(value, [one.name for one in fields(Range)], where, *keys)
            for key, kind in (("low", int | float), ("high", int | float), ("log", bool), ("integer", bool)):
                if not isinstance(value.get(key, False), kind) or (
                    key in ("low", "high") and key not in value
                ):
                    raise SettingError(
                        f"{where} needs a proper {key}, as in {{low = 0.01, high = 1.0}}", *keys
                    )
            try:
                found[name] = Range(**value)
            except SettingError as error:
                raise error.inside(*keys) from None
        else:
            raise SettingError(
                f"{where} is a range such as {{low = 0.01, high = 1.0}}, or a list of values", *keys
            )
    return found


def tune_tables(tune: TunePlan) -> dict[str, dict[str, Any]]:
    """Return the tables from which `parse_tune` returns an equal search, by their headings."""
    numbers = {one.name: getattr(tune, one.name) for one in fields(tune) if one.name != "space"}
    tables: dict[str, dict[str, Any]] = {"": numbers}
    for label, space in tune.space.items():
        tables[label] = dict(space)
    return tables
