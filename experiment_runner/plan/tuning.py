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
from typing import Annotated, Literal

from msgspec import Meta, Struct

from experiment_runner.plan.toml import is_option, shown
from glue.options import Value

_Count = Annotated[int, Meta(ge=1, le=1_000_000)]


class Range(Struct, frozen=True, forbid_unknown_fields=True):
    """The values of an option from `low` to `high`, inclusive.

    Args:
        low, high: the ends.
        log: whether the logarithms of the values are spaced or drawn evenly.
        integer: whether the values are whole numbers.
        points: number of values in a grid.

    Raises:
        ValueError: the ends are in the wrong order, or cannot have logarithms.
    """

    low: int | float
    high: int | float
    log: bool = False
    integer: bool = False
    points: Annotated[int, Meta(ge=2, le=1_000_000)] = 5

    def __post_init__(self) -> None:
        known = is_option(self.low) and is_option(self.high)
        if not (known and self.low < self.high) or (self.log and self.low <= 0):
            raise ValueError(
                f"a range is from low to a greater high{', above 0' if self.log else ''}, "
                f"not from {shown(self.low)} to {shown(self.high)}"
            )

    def at(self, share: float) -> Value:
        """Return the value at a share, 0 to 1, of the way from low to high."""
        if self.log:
            value = float(self.low * (self.high / self.low) ** share)
        else:
            value = float(self.low + (self.high - self.low) * share)
        value = min(max(value, self.low), self.high)
        return round(value) if self.integer else value


Space = Mapping[str, Range | Annotated[tuple[Value, ...], Meta(min_length=1)]]
"""The values of an agent's options that are searched, by option."""


class TunePlan(Struct, frozen=True, forbid_unknown_fields=True):
    """A search for the options of agents.

    Args:
        agents: the values of each agent's options, by its label.
        sampler: the method that chooses configurations.
        configurations: of each agent; a grid may have fewer.
        trials: of each configuration.
        final: trials of the chosen configuration, with seeds that the search has not used.
        prune: whether the worse half of the configurations is pruned after a quarter of each trial.
    """

    agents: Annotated[Mapping[str, Space], Meta(min_length=1)]
    sampler: Literal["random", "grid", "optuna"] = "random"
    configurations: _Count = 20
    trials: _Count = 3
    final: _Count = 10
    prune: bool = False
