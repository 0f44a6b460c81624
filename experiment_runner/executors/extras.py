"""The extras of an environment, each summed up as one number for an episode."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from experiment_runner.plan.extras import SUMMARIES, Summary, extra_of
from glue.errors import ExperimentError
from glue.types import Observation


class Extras:
    """Reader of an environment's extras, which gives a number for each in an episode.

    Args:
        plan: the summary of each extra; see `experiment_runner.plan.extras`.
        label: the environment's.
    """

    def __init__(self, plan: Mapping[str, Summary], label: str) -> None:
        self._label = label
        self._summaries = {extra_of(key, label): how for key, how in plan.items()}
        self._values: dict[str, dict[str, float]] = {}  # each summary so far, and the count
        self._found: set[str] = set()  # those that have been numbers

    def begin(self) -> None:
        """Begin an episode."""
        self._values = {}

    def see(self, observation: Observation) -> None:
        """Take the extras of the episode's next observation.

        Raises:
            ExperimentError: one of the plan is a text, bytes or an array, and never was a number.
        """
        for given, value in observation.extras.items():
            name = extra_of(given, self._label)  # an environment may also put its own name before an extra's
            if name not in self._summaries:
                continue
            if isinstance(value, int | float):
                self._found.add(name)
                self._values[name] = _with(float(value), self._values.get(name))
            elif name not in self._found:
                numbers = [key for key, one in observation.extras.items() if isinstance(one, int | float)]
                raise ExperimentError(
                    f"the extra {name} of {self._label} cannot be a metric: it is {value!r:.40}, not a "
                    f"number; numbers among its extras: {', '.join(numbers) or 'none'}"
                )

    def numbers(self) -> dict[str, float]:
        """Return the number of each extra in the episode, by the environment's label, a dot, and its name."""
        return {
            f"{self._label}.{name}": self._values[name][how]
            for name, how in self._summaries.items()
            if name in self._values
        }

    def missing(self) -> Iterator[str]:
        """Yield for each extra of the plan without a number in the episode why there is none.

        One whose name has a dot may be that of an environment with another label.
        """
        for name in self._summaries:
            if name not in self._values and "." not in name:
                yield f"the environment sent no extra {name}: some send extras only if an option says so"


def _with(value: float, before: dict[str, float] | None) -> dict[str, float]:
    """Return the summaries of an extra's values, and their count, after one more value."""
    if before is None:
        return {"count": 1, **dict.fromkeys(SUMMARIES, value)}
    total, count = before["sum"] + value, before["count"] + 1
    least, most = min(before["min"], value), max(before["max"], value)
    after = {"last": value, "sum": total, "count": count, "mean": total / count, "min": least, "max": most}
    return before | after
