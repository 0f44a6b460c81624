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

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Literal

from msgspec import Meta

from experiment_runner.plan.toml import SettingError, converted, is_option, shown
from glue.options import Value

_Count = Annotated[int, Meta(ge=1, le=1_000_000)]


@dataclass(frozen=True, slots=True)
class Range:
    """The values of an option from `low` to `high`, inclusive.

    Args:
        low, high: the ends.
        log: whether the logarithms of the values are spaced or drawn evenly.
        integer: whether the values are whole numbers.
        points: number of values in a grid.

    Raises:
        SettingError: the ends are in the wrong order, too far apart for floats, cannot have logarithms, or
            have no whole number between them where one is wanted.
    """

    low: int | float
    high: int | float
    log: bool = False
    integer: bool = False
    points: Annotated[int, Meta(ge=2, le=1_000_000)] = 5

    def __post_init__(self) -> None:
        known = is_option(self.low) and is_option(self.high)
        if not (known and self.low < self.high) or (self.log and self.low <= 0):
            raise SettingError(
                f"a range is from low to a greater high{', above 0' if self.log else ''}, "
                f"not from {shown(self.low)} to {shown(self.high)}"
            )
        low, high = float(self.low), float(self.high)
        if not math.isfinite(high / low if self.log else high - low):
            raise SettingError(f"a range from {shown(self.low)} to {shown(self.high)} is too wide to search")
        first, last = self.ends
        if first > last:
            raise SettingError(f"there is no whole number from {shown(self.low)} to {shown(self.high)}")

    @property
    def ends(self) -> tuple[int | float, int | float]:
        """The least and the greatest value."""
        return (math.ceil(self.low), math.floor(self.high)) if self.integer else (self.low, self.high)

    def at(self, share: float) -> Value:
        """Return the value at a share, 0 to 1, of the way from low to high."""
        if self.log:
            value = float(self.low * (self.high / self.low) ** share)
        else:
            value = float(self.low + (self.high - self.low) * share)
        first, last = self.ends
        value = min(max(value, first), last)
        return round(value) if self.integer else value


Space = Mapping[str, Range | tuple[Value, ...]]
"""The values of an agent's options that are searched, by option."""


@dataclass(frozen=True, slots=True)
class TunePlan:
    """A search for the options of agents.

    Args:
        agents: the values of each agent's options, by its label.
        sampler: the method that chooses configurations.
        configurations: of each agent; a grid may have fewer.
        trials: of each configuration.
        final: trials of the chosen configuration, with seeds that the search has not used.
        prune: whether the worse half of the configurations is pruned after a quarter of each trial.

    Raises:
        SettingError: there are no options to search.
    """

    agents: Mapping[str, Space]
    sampler: Literal["random", "grid", "optuna"] = "random"
    configurations: _Count = 20
    trials: _Count = 3
    final: _Count = 10
    prune: bool = False

    def __post_init__(self) -> None:
        if not self.agents:
            raise SettingError("tune needs the options to search, as in: [tune.agents.NAME]")


def parse_tune(table: Any) -> TunePlan:
    """Return the search that the table `tune` of a plan describes.

    Raises:
        SettingError: a key or value does not belong there.
    """
    agents = table.get("agents", {}) if isinstance(table, dict) else None
    if not isinstance(agents, dict) or not all(isinstance(space, dict) for space in agents.values()):
        where = ("tune", "agents") if agents else ("tune",)
        raise SettingError("tune has its options in tables, as in: [tune.agents.NAME]", *where)
    spaces = {
        label: {name: _values(value, "tune", "agents", label, name) for name, value in space.items()}
        for label, space in agents.items()
    }
    return converted(TunePlan, table | {"agents": spaces}, "tune", "tune")


def _values(value: object, *keys: str) -> Range | tuple[Value, ...]:
    if isinstance(value, dict):
        return converted(Range, value, ".".join(keys), *keys)
    if isinstance(value, list) and value and all(map(is_option, value)):
        return tuple(value)
    raise SettingError(
        f"{'.'.join(keys)} is a range such as {{low = 0.01, high = 1.0}}, or a list of values", *keys
    )
