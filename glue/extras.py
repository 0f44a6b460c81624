"""Extras: named values that an environment attaches to an observation, for everyone but the agent.

On the wire they are one msgpack map from a name to an int, a float, a text, bytes, or an array of ints or of
floats. Nothing nests.
"""

from __future__ import annotations

from collections.abc import Mapping
from enum import Enum
from typing import Any, Final

import msgpack
import numpy as np
import numpy.typing as npt

from glue.errors import LocalProtocolError, RemoteProtocolError

MAX_EXTRAS: Final = 64
"""Maximum number of extras of an observation."""

MAX_EXTRA_NAME: Final = 64
"""Maximum length of a name, in characters."""

MAX_EXTRAS_SIZE: Final = 2**16 - 1
"""Maximum size of all extras of an observation, in bytes."""

Extra = int | float | str | bytes | tuple[int, ...] | tuple[float, ...]
GivenExtra = Extra | list[int] | list[float] | Enum | np.generic | npt.NDArray[Any]
"""The values that an environment may give: also lists, NumPy's scalars and flat arrays, members of enums."""

_INT64: Final = range(-(2**63), 2**63)
_ALLOWED: Final = "a number, a text, bytes, or a flat list of ints or of floats"


def pack_extras(extras: Mapping[str, GivenExtra]) -> bytes:
    """Return the wire form of extras.

    Raises:
        LocalProtocolError: a name or value is not one that extras may have, or they exceed a limit.
    """
    if not isinstance(extras, Mapping):
        raise LocalProtocolError(f"extras are values by name, not {extras!r:.80}")
    if len(extras) > MAX_EXTRAS:
        raise LocalProtocolError(f"an observation has at most {MAX_EXTRAS} extras; {len(extras)} are given")
    plain = {}
    for name, value in extras.items():
        plain[name] = given = _plain(value)
        if why := _fault(name, given):
            raise LocalProtocolError(f"{why}; {value!r:.80} is given")
    try:
        packed: bytes = msgpack.packb(plain)
    except UnicodeEncodeError as error:
        raise LocalProtocolError(f"a text among the extras is not Unicode: {error}") from None
    if len(packed) > MAX_EXTRAS_SIZE:
        raise LocalProtocolError(
            f"the extras of an observation take at most {MAX_EXTRAS_SIZE} bytes; these take {len(packed)}"
        )
    return packed


def unpack_extras(packed: bytes) -> dict[str, Extra]:
    """Return the extras of a wire form of at most `MAX_EXTRAS_SIZE` bytes.

    Raises:
        RemoteProtocolError: it is not a wire form of extras.
    """
    try:
        # Maps become tuples of pairs, arrays lists: a map in a map is recognised, and so is a repeated name.
        pairs = msgpack.unpackb(
            packed, object_pairs_hook=tuple, max_map_len=MAX_EXTRAS, max_ext_len=0, strict_map_key=True
        )
    except (ValueError, msgpack.UnpackException, RecursionError) as error:
        raise RemoteProtocolError(
            "the environment sent extras that are not msgpack within the limits: "
            f"{str(error) or type(error).__name__}"
        ) from None
    if type(pairs) is not tuple:
        raise RemoteProtocolError(f"the environment sent extras that are {pairs!r:.40} instead of a map")
    for name, value in pairs:
        if why := _fault(name, value):
            raise RemoteProtocolError(f"the environment sent {value!r:.40} as an extra, but {why}")
    extras = {name: tuple(value) if type(value) is list else value for name, value in pairs}
    if len(extras) != len(pairs):
        raise RemoteProtocolError("the environment sent two extras with the same name")
    return extras


def _plain(value: GivenExtra) -> Any:
    """Return a value as Python's own, in a list if there are several."""
    if isinstance(value, np.ndarray) and value.ndim <= 1 and value.dtype.kind in "biuf":
        value = value.tolist()
    return [_scalar(one) for one in value] if isinstance(value, list | tuple) else _scalar(value)


def _scalar(value: Any) -> Any:
    """Return a number, text or bytes of NumPy or of an enum as Python's own, anything else as it is."""
    if isinstance(value, Enum):
        value = value.value
    if isinstance(value, np.generic) and value.dtype.kind in "biufSU":
        value = value.item()
    return int(value) if type(value) is bool else value


def _fault(name: object, value: object) -> str:
    """Return the fault of a name or its value as a text; "" if there is none."""
    if type(name) is not str or not 0 < len(name) <= MAX_EXTRA_NAME or not name.isprintable():
        return f"the name of an extra has 1 to {MAX_EXTRA_NAME} printable characters, not {name!r:.80}"
    if type(value) in (float, str, bytes) or (type(value) is int and value in _INT64):
        return ""
    if type(value) is list:
        types = set(map(type, value))
        if types <= {float} or (types == {int} and min(value) in _INT64 and max(value) in _INT64):
            return ""
    return f"the extra {name!r} must be {_ALLOWED}, its ints of 64 bits"
