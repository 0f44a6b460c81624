"""An agent's metrics as the body of a message: the values as doubles, the names as chars, one per line."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from typing import Final

from glue.errors import PeerFailed
from glue.types import Observation

MAX_METRICS: Final = 1000
MAX_METRIC_NAME: Final = 64
"""Maximum length of a name, in characters."""


def checked_metrics(metrics: Mapping[str, float]) -> dict[str, float]:
    """Return an agent's metrics as floats.

    Raises:
        AttributeError, TypeError: `metrics` is not a mapping, or a value is not a number.
        ValueError: there are too many, or a name is not a text, is empty, too long or has a line break.
    """
    found = {name: float(value) for name, value in metrics.items()}
    _check_names(tuple(found))
    return found


def pack_metrics(metrics: Mapping[str, float]) -> Observation:
    """Return the body for the result of `checked_metrics`."""
    return Observation([], [*metrics.values()], "\n".join(metrics).encode())


def unpack_metrics(body: Observation) -> dict[str, float]:
    """Return the metrics of a body.

    Raises:
        PeerFailed: the names do not match the numbers, or exceed the limits.
    """
    values = body.doubles
    count = body.chars.count(b"\n") + 1 if body.chars else 0
    try:
        if not len(values) == count <= MAX_METRICS:  # before 16 million names are split
            raise ValueError
        names = tuple(body.chars.decode(errors="replace").split("\n")) if count else ()
        _check_names(names)
        return dict(zip(names, values.tolist(), strict=True))
    except ValueError:
        raise PeerFailed(
            f"the agent's metrics have {len(values)} numbers and {count} names; each number has a name "
            f"of its own, of 1 to {MAX_METRIC_NAME} characters, and there are at most {MAX_METRICS}"
        ) from None


@lru_cache  # an agent's names hardly ever change
def _check_names(names: tuple[object, ...]) -> None:
    plain = (isinstance(n, str) and 0 < len(n) <= MAX_METRIC_NAME and n.isprintable() for n in names)
    if not len(names) == len(set(names)) <= MAX_METRICS or not all(plain):
        raise ValueError(f"metrics are at most {MAX_METRICS} numbers with names in one line")
