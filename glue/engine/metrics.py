"""The numbers of an agent as the body of a message: doubles, with their names as chars, a line for each."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
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
    values = [float(value) for value in metrics.values()]
    return Observation([], values, _joined(tuple(metrics)))


def unpack_metrics(body: Observation) -> dict[str, float]:
    """Return the metrics of a body.

    Raises:
        PeerFailed: the names do not fit the numbers, or the limits.
    """
    names, valid = _parted(body.chars)
    values = body.doubles.tolist()
    if not valid or len(values) != len(names):
        raise PeerFailed(
            f"the agent's metrics have {len(values)} numbers and {len(names)} names; each number has a name "
            f"of its own, of 1 to {MAX_METRIC_NAME} characters, and there are at most {MAX_METRICS}"
        )
    return dict(zip(names, values, strict=True))


# An agent's names are nearly always those of the time before, so they are checked once.


@lru_cache
def _joined(names: tuple[object, ...]) -> bytes:
    if len(names) > MAX_METRICS or not all(map(_is_name, names)):
        raise ValueError(f"metrics are at most {MAX_METRICS} numbers with names in one line")
    return "\n".join(map(str, names)).encode()


@lru_cache
def _parted(chars: bytes) -> tuple[tuple[str, ...], bool]:
    """Return the names in the chars of a body, and whether they may be names."""
    names = tuple(chars.decode(errors="replace").split("\n")) if chars else ()
    return names, len(names) == len(set(names)) <= MAX_METRICS and all(map(_is_name, names))


def _is_name(name: object) -> bool:
    return isinstance(name, str) and 0 < len(name) <= MAX_METRIC_NAME and name.isprintable()
