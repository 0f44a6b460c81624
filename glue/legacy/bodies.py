"""Texts and abstract types in the binary format of the original RL-Glue 3.x; see `glue.legacy.codec`."""

from __future__ import annotations

import struct
from array import array
from collections.abc import Mapping
from typing import Final

from glue.errors import LocalProtocolError, RemoteProtocolError
from glue.types import body_size
from glue.wire.messages import Body

MAX_COUNT: Final = 1_000_000
"""Maximum number of ints, doubles or chars in one abstract type; the original's own limit."""

MAX_STRING: Final = 1_000_000
"""Maximum size of a text, in bytes. The original had no limit."""

_MAX_REMEMBERED: Final = 65_536
"""Maximum size of a cached body, in bytes, which bounds the memory of a hub."""

_COUNT: Final = struct.Struct(">I")
_THEIR_COUNTS: Final = struct.Struct(">3I")
_OUR_COUNTS: Final = struct.Struct("<4I")


class BodyForm:
    """One kind of body in both formats; this class itself is that of messages without one.

    Attributes:
        latest: a body in their format and in ours, the latest or an empty one. A payload that has theirs at
            an offset has ours there, so callers compare first, and call `read` or `write` if it differs.
        largest: maximum size in a payload, in bytes.
    """

    latest: tuple[bytes, bytes] = b"", b""
    largest: int = 0

    def read(self, payload: bytes, offset: int) -> tuple[bytes, int]:
        """Return our body in a payload, and the offset after it."""
        return b"", offset

    def write(self, body: bytes) -> bytes:
        """Return the bytes of our body in a payload."""
        return b""


class _Text(BodyForm):
    latest = _COUNT.pack(0), b""
    largest = _COUNT.size + MAX_STRING

    def read(self, payload: bytes, offset: int) -> tuple[bytes, int]:
        start = offset + _COUNT.size
        if start > len(payload):
            raise too_short(_COUNT.size, payload, offset)
        (count,) = _COUNT.unpack_from(payload, offset)
        if count > MAX_STRING:
            raise RemoteProtocolError(f"a text has at most {MAX_STRING} bytes; {count} are announced")
        if start + count > len(payload):
            raise too_short(count, payload, start)
        return payload[start : start + count], start + count

    def write(self, body: bytes) -> bytes:
        text = until_zero(body)
        if len(text) > MAX_STRING:
            raise LocalProtocolError(f"a text has at most {MAX_STRING} bytes; this one has {len(text)}")
        return _COUNT.pack(len(text)) + text


def until_zero(text: bytes) -> bytes:
    """Return `text` up to its first zero byte, where a C string ends."""
    return text.partition(b"\0")[0]


class _Type(BodyForm):
    """One abstract type.

    The latest value is cached: an environment's observation is written for the agent right after it was
    read, and an action is often the same as in the previous step.
    """

    latest = _THEIR_COUNTS.pack(0, 0, 0), _OUR_COUNTS.pack(0, 0, 0, 0)
    largest = _THEIR_COUNTS.size + (4 + 8 + 1) * MAX_COUNT

    def read(self, payload: bytes, offset: int) -> tuple[bytes, int]:
        theirs, ours = self.latest
        if payload.startswith(theirs, offset):
            return ours, offset + len(theirs)
        at_ints = offset + _THEIR_COUNTS.size
        if at_ints > len(payload):
            raise too_short(_THEIR_COUNTS.size, payload, offset)
        ints, doubles, chars = counts = _THEIR_COUNTS.unpack_from(payload, offset)
        if max(counts) > MAX_COUNT:
            raise RemoteProtocolError(_too_many(ints, doubles, chars))
        at_doubles = at_ints + 4 * ints
        at_chars = at_doubles + 8 * doubles
        end = at_chars + chars
        if end > len(payload):
            raise too_short(end - at_ints, payload, at_ints)
        body = b"".join(
            (
                _OUR_COUNTS.pack(ints, doubles, chars, 0),
                _reversed("q", payload[at_doubles:at_chars]),
                _reversed("i", payload[at_ints:at_doubles]),
                payload[at_chars:end],
            )
        )
        self._remember(payload[offset:end], body)
        return body, end

    def write(self, body: bytes) -> bytes:
        theirs, ours = self.latest
        if body == ours:
            return theirs
        size = body_size(body)
        if size != len(body):
            raise LocalProtocolError(f"an abstract type of {size} bytes by its counts has {len(body)}")
        ints, doubles, chars, _ = _OUR_COUNTS.unpack_from(body)
        if max(ints, doubles, chars) > MAX_COUNT:
            raise LocalProtocolError(_too_many(ints, doubles, chars))
        at_ints = _OUR_COUNTS.size + 8 * doubles
        at_chars = at_ints + 4 * ints
        payload = b"".join(
            (
                _THEIR_COUNTS.pack(ints, doubles, chars),
                _reversed("i", body[at_ints:at_chars]),
                _reversed("q", body[_OUR_COUNTS.size : at_ints]),
                body[at_chars:],
            )
        )
        self._remember(payload, body)
        return payload

    def _remember(self, theirs: bytes, ours: bytes) -> None:
        if len(ours) <= _MAX_REMEMBERED:
            self.latest = theirs, ours


_OBSERVATION: Final = _Type()
_ACTION: Final = _Type()


class _TwoTypes(BodyForm):
    """An observation and an action."""

    latest = 2 * _Type.latest[0], 2 * _Type.latest[1]
    largest = 2 * _Type.largest

    def read(self, payload: bytes, offset: int) -> tuple[bytes, int]:
        observation, offset = _OBSERVATION.read(payload, offset)
        action, offset = _ACTION.read(payload, offset)
        return observation + action, offset

    def write(self, body: bytes) -> bytes:
        observation, our_observation = _OBSERVATION.latest
        action, our_action = _ACTION.latest
        # Both have usually just been read. A body's counts come first: nothing longer can begin with it.
        if (
            len(body) == len(our_observation) + len(our_action)
            and body.startswith(our_observation)
            and body.endswith(our_action)
        ):
            return observation + action
        size = body_size(body)
        return _OBSERVATION.write(body[:size]) + _ACTION.write(body[size:])


def _reversed(typecode: str, run: bytes) -> bytes:
    """Return `run` with the bytes of each 4-byte ("i") or 8-byte ("q") number reversed."""
    # An array is twice as fast as NumPy for the few numbers of most observations.
    numbers = array(typecode)
    numbers.frombytes(run)
    numbers.byteswap()
    return numbers.tobytes()


def _too_many(ints: int, doubles: int, chars: int) -> str:
    return (
        f"an original program takes at most {MAX_COUNT} of each in an abstract type; "
        f"received {ints} ints, {doubles} doubles, {chars} chars"
    )


def too_short(needed: int, payload: bytes, offset: int) -> RemoteProtocolError:
    """Return the error of a payload with fewer than `needed` bytes from `offset` on."""
    left = len(payload) - offset
    return RemoteProtocolError(f"{needed} more bytes were expected at byte {offset}; {left} are left")


BODIES: Final[Mapping[Body, BodyForm]] = {
    Body.NONE: BodyForm(),
    Body.OBSERVATION: _OBSERVATION,
    Body.ACTION: _ACTION,
    Body.OBSERVATION_ACTION: _TwoTypes(),
    Body.TEXT: _Text(),
}
