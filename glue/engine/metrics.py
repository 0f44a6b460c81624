"""The numbers of an agent as the body of a message: doubles, with their names as chars, a line for each."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from glue.errors import PeerFailed
from glue.types import Observation

MAX_METRICS: Final = 1000
MAX_METRIC_NAME: Final = 64
"""Maximum length of a name, in characters."""


def pack_metrics(metrics: Mapping[str, float]) -> Observation:
    """Return the body for an agent's metrics.

    Raises:
        TypeError: a name is not a text, or a value not a number.
        ValueError: there are too many, or a name is empty, too long or has a line break.
    """
    names, values = [*metrics], [float(value) for value in metrics.values()]
    if len(names) > MAX_METRICS or not all(map(_is_name, names)):
        raise ValueError(f"metrics are at most {MAX_METRICS} numbers with names in one line")
    return Observation([], values, "\n".join(names).encode())


def unpack_metrics(body: Observation) -> dict[str, float]:
    """Return the metrics of a body.

    Raises:
        PeerFailed: the names do not fit the numbers, or the limits.
    """
    names = body.chars.decode(errors="replace").split("\n") if len(body.chars) else []
    values = body.doubles.tolist()
    fit = len(values) == len(names) == len(set(names)) <= MAX_METRICS
    if not fit or not all(map(_is_name, names)):
        raise PeerFailed(
            f"the agent's metrics have {len(values)} numbers and {len(names)} names; each number has a name "
            f"of its own, of 1 to {MAX_METRIC_NAME} characters, and there are at most {MAX_METRICS}"
        )
    return dict(zip(names, values, strict=True))


def _is_name(name: object) -> bool:
    return isinstance(name, str) and 0 < len(name) <= MAX_METRIC_NAME and name.isprintable()
