"""Encode messages as the frames that cross the wire, and decode them.

A message is a header frame, the msgpack array `[kind, session, seq, scalar, ...]`, and, if its kind has a
body, a second frame. All input is checked here, sizes first, so that no code after this module sees a value
of an unexpected type.

The layout is described byte by byte in docs/protocol-reference.md.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

import msgpack

from glue.errors import LocalProtocolError, RemoteProtocolError
from glue.types import CUT_OFF, body_size, has_beside
from glue.wire.messages import (
    CALLS,
    CONTROL,
    MAX_BODY,
    MAX_HEADER,
    MAX_NAME,
    OBSERVING,
    Body,
    Kind,
    Message,
    Scalar,
    Shape,
    Value,
)

_MAX_NOTE: Final = 1000
"""Length in bytes to which a text for people is cut; with the longest session name it still fits a header."""

_NUMBERS_END: Final = 2**63
"""Exclusive upper bound of the whole numbers in a header, such as sequence numbers; they start at 0."""

TO_HUB: Final[Mapping[Kind, Shape]] = {
    **{kind: call.request if call.callee is None else call.reply for kind, call in CALLS.items()},
    **CONTROL,
    Kind.OBSERVE: OBSERVING[Kind.OBSERVE],
}
"""Messages to the hub: replies of agents and environments, requests of experiments, control, OBSERVE."""

FROM_HUB: Final[Mapping[Kind, Shape]] = {
    **{kind: call.reply if call.callee is None else call.request for kind, call in CALLS.items()},
    **CONTROL,
    **OBSERVING,
}
"""Messages from the hub: the other half of each call."""

_METRICS: Final = frozenset({Kind.AGENT_METRICS, Kind.RL_AGENT_METRICS})

_KINDS: Final = {int(kind): kind for kind in Kind}

_EXPECTED: Final[Mapping[type, str]] = {
    bool: "true or false",
    bytes: "binary",
    float: "a number",
    int: "a whole number from 0 to 2^63 - 1",
    str: "a text",
}


class UnknownKind(RemoteProtocolError):
    """The header is well formed, but its kind is unknown; `session` and `seq` are those of the header."""

    def __init__(self, kind: int, session: str, seq: int) -> None:
        super().__init__(f"message kind {kind} is not one of protocol version 1")
        self.session = session
        self.seq = seq


def encode(message: Message, shapes: Mapping[Kind, Shape]) -> tuple[bytes, ...]:
    """Return the frames of `message`: a header, and a body if its shape has one.

    Raises:
        LocalProtocolError: the header would be longer than MAX_HEADER.
    """
    kind, session, seq, scalars, body = message
    header: bytes = msgpack.packb((int(kind), session, seq, *scalars))
    if len(header) > MAX_HEADER:
        raise LocalProtocolError(
            f"the header of {kind.name} would take {len(header)} bytes; {MAX_HEADER} are allowed"
        )
    if shapes[kind].body is Body.NONE:
        return (header,)
    return header, body


def decode(frames: Sequence[bytes], shapes: Mapping[Kind, Shape], max_body: int = MAX_BODY) -> Message:
    """Return the message that `frames` hold, fully checked.

    `shapes` is TO_HUB or FROM_HUB, depending on the direction of the frames.

    Raises:
        UnknownKind: the kind is not one of `shapes`.
        RemoteProtocolError: the frames violate docs/protocol-reference.md in any other way.
    """
    count = len(frames)
    if not 1 <= count <= 2:
        raise RemoteProtocolError(f"a message has one or two frames; {count} received")
    kind, session, seq, scalars = _decode_header(frames[0])
    known = _KINDS.get(kind)
    shape = None if known is None else shapes.get(known)
    if known is None or shape is None:
        raise UnknownKind(kind, session, seq)
    checked = tuple(scalars)
    if tuple(map(type, scalars)) != shape.plain:
        checked = _coerce_all(known, shape, scalars)
    if shape.body is Body.NONE:
        if count != 1:
            raise RemoteProtocolError(f"{known.name} has no body; one of {len(frames[1])} bytes was received")
        return Message(known, session, seq, checked)
    if count != 2:
        raise RemoteProtocolError(f"{known.name} needs a body frame; none received")
    body = frames[1]
    _check_body(known, shape.body, body, max_body)
    return Message(known, session, seq, checked, body)


def clip(text: str, limit: int = _MAX_NOTE) -> str:
    """Return `text` fit for a header and a terminal: without control characters, about `limit` bytes."""
    clean = "".join(c if c.isprintable() else " " for c in text[: limit + 1]).encode()
    return clean.decode() if len(clean) <= limit else clean[:limit].decode(errors="ignore") + "..."


def _decode_header(frame: bytes) -> tuple[int, str, int, list[Value]]:
    if len(frame) > MAX_HEADER:
        raise RemoteProtocolError(f"a header of {len(frame)} bytes was received; {MAX_HEADER} are allowed")
    try:
        header = msgpack.unpackb(
            frame,
            use_list=True,
            max_array_len=64,
            max_map_len=0,
            max_ext_len=0,
            max_str_len=MAX_HEADER,
            max_bin_len=MAX_HEADER,
        )
    except (ValueError, msgpack.UnpackException, RecursionError) as error:
        raise RemoteProtocolError(
            f"the header is not msgpack within the limits: {str(error) or type(error).__name__}"
        ) from None
    if type(header) is not list or len(header) < 3:
        raise RemoteProtocolError("a header is an array of a kind, a session, a sequence number, ...")
    kind, session, seq = header[:3]
    if type(kind) is not int:
        raise RemoteProtocolError(f"a kind is a whole number, not {kind!r:.40}")
    if type(session) is not str or len(session) > MAX_NAME:
        raise RemoteProtocolError(f"a session is a text of at most {MAX_NAME} characters")
    if type(seq) is not int or not 0 <= seq < _NUMBERS_END:
        raise RemoteProtocolError(f"a sequence number is from 0 to 2^63 - 1, not {seq!r:.40}")
    return kind, session, seq, header[3:]


def _coerce_all(kind: Kind, shape: Shape, scalars: list[Value]) -> tuple[Value, ...]:
    """Return the scalars converted to the types of `shape`; not needed on the hot path."""
    expected = shape.scalars if len(scalars) == len(shape.scalars) else shape.scalars + shape.more
    if len(scalars) != len(expected):
        raise RemoteProtocolError(f"{kind.name} has {len(shape.scalars)} scalars; {len(scalars)} received")
    return tuple(
        # A whole number has a range as well as a type.
        value if type(value) is scalar.type is not int else _coerce(kind, scalar, value)
        for scalar, value in zip(expected, scalars, strict=True)
    )


def _coerce(kind: Kind, scalar: Scalar, value: object) -> Value:
    """Return `value` converted to the scalar's type if that is lossless; rarely called on the hot path."""
    wanted = scalar.type
    if value is None and scalar.optional:
        return None
    if wanted is int and type(value) is int and 0 <= value < _NUMBERS_END:
        return value
    if wanted is float and type(value) is int and abs(value) <= 2**53:
        return float(value)
    if wanted is bool and type(value) is int:
        # RL-Glue's terminal is an int; its own code treats values other than 0 and 1 inconsistently.
        return value if scalar.cuts and value == CUT_OFF else value != 0
    if wanted is tuple and type(value) is list and all(type(item) is scalar.items for item in value):
        return tuple(value)
    expected = _EXPECTED[scalar.items or wanted]
    if scalar.items is not None:
        expected = f"an array, each item {expected}"
    raise RemoteProtocolError(f"{scalar.name} of {kind.name} is {expected}; {value!r:.40} received")


def _check_body(kind: Kind, body_kind: Body, body: bytes, max_body: int) -> None:
    size = len(body)
    if body_kind is Body.OBSERVATION_ACTION:
        # The observation and the action were each within the limit when the hub received them.
        max_body *= 2
    if size > max_body:
        raise RemoteProtocolError(f"the body of {kind.name} has {size} bytes; {max_body} are allowed")
    if body_kind is Body.OBSERVATION or body_kind is Body.ACTION:
        expected = body_size(body)
        bare = body_kind is Body.ACTION or kind in _METRICS
        at = 0
    elif body_kind is Body.OBSERVATION_ACTION:
        at = min(body_size(body), size)
        expected = at + body_size(body, at)
        bare = True
    else:
        return
    if bare and has_beside(body, at):
        raise RemoteProtocolError(f"bytes 12 to 15 of an action or of metrics in {kind.name} must be zero")
    if expected != size:
        raise RemoteProtocolError(
            f"the counts in the body of {kind.name} say {expected} bytes; it has {size}"
        )
