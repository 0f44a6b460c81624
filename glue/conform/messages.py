"""Comparison of messages with expected ones, and their text in verdicts."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from typing import Any, Final

from glue.errors import RemoteProtocolError
from glue.types import Observation, body_size
from glue.wire.codec import TO_HUB, encode
from glue.wire.messages import Message

_SHOWN: Final = 300
"""Maximum number of characters of a message in a verdict."""


def described(message: Message) -> str:
    """Return a message as verdicts show it."""
    scalars = "".join(f" {scalar!r}" for scalar in message.scalars)
    body = f" with {message.body[:200].hex(' ')}" if message.body else ""
    text = f"{message.kind.name} {message.seq}{scalars}{body}"
    return text if len(text) <= _SHOWN else f"{text[:_SHOWN]}... ({len(message.body)} bytes)"


def same(wanted: Message, got: Message) -> bool:
    """Return whether two messages are equal; any NaN equals any other."""
    if wanted == got:
        return True
    return wanted[:3] == got[:3] and _plain(wanted) == _plain(got)


def _plain(message: Message) -> list[Any]:
    """Return scalars and body in a form in which all NaNs are equal, and negative zero differs from zero."""
    values: list[Any] = [_bits(v) if isinstance(v, float) else v for v in message.scalars]
    body = message.body
    shape = TO_HUB[message.kind].body.name
    if shape not in ("OBSERVATION", "ACTION", "OBSERVATION_ACTION"):
        return [*values, body]
    while body:
        size = body_size(body)
        value = Observation.from_body(body[:size])
        values += [value.counts, value.ints.tolist(), list(map(_bits, value.doubles.tolist())), value.chars]
        values += [value.packed_mask, _extras(value)]
        body = body[size:]
    return values


def _extras(observation: Observation) -> object:
    """Return extras in a form in which their order and the formats of msgpack do not matter."""
    try:
        return observation.extras
    except RemoteProtocolError as error:
        return str(error)


def _bits(value: float) -> bytes:
    return b"NaN" if value != value else struct.pack(">d", value)


def difference(wanted: Message, frames: Sequence[bytes]) -> str:
    """Return where the frames begin to differ from those of the message that was expected."""
    for name, one, other in zip(("header", "body"), encode(wanted, TO_HUB), frames, strict=False):
        if one != other:
            at = next((i for i, (a, b) in enumerate(zip(one, other, strict=False)) if a != b), -1)
            if at < 0:
                return f"; the {name} has {len(other)} bytes instead of {len(one)}"
            return f"; byte {at} of the {name} is {other[at]:02x} instead of {one[at]:02x}"
    return ""
