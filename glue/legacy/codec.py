"""The binary format of the original RL-Glue 3.x, without I/O: bytes in, messages out, and back.

    frame          int32 kind, uint32 payload size, payload
    text           uint32 byte count, bytes
    abstract type  uint32 number of ints I, of doubles D, of chars C,
                   then I int32, D float64 and C bytes; nothing in between

Everything is big-endian. A reply has the kind of its request, so what a payload holds depends on
who sent it: the tables `FROM_AGENT`, `TO_AGENT` and so on say it, as seen from the server.
Observations and actions are kept as bodies of `glue.types.AbstractType`, whose bytes run the other
way round and whose doubles come first; only bytes move, so every bit of a NaN survives.

What the original server did with odd input, and what is done here:

- A payload longer than needed: the surplus is ignored, up to `SURPLUS` bytes.
- A payload shorter than needed: the original read on in old memory; here it is an error.
- A zero byte in a text ends the text, in both directions, as in the original's C strings.
- More than a million ints, doubles or chars: the original server exited; here it is an error.
- The Java client counts a text in UTF-16 units, yet sends UTF-8. Beyond ASCII its count, and the
  size of the frame, are too small, and the end of the text hangs over behind the frame. The first
  byte of a frame is always zero, that of an overhang hardly ever: so what follows the frame of a
  text that is not ASCII, up to the next zero byte, is the end of the text. Should the network part
  the two just there, the text is delivered without its end, as the original did every time,
  and the end is dropped when it comes.

Source: RL-Glue core 3.04, RL_network.c; rl-glue-ext, Java codec, Network.java.
"""

from __future__ import annotations

import struct
from array import array
from collections.abc import Callable, Mapping
from typing import Any, Final, NamedTuple

from glue.errors import LocalProtocolError, RemoteProtocolError

__all__ = [
    "AGENT",
    "ENVIRONMENT",
    "EXPERIMENT",
    "FROM_AGENT",
    "FROM_ENVIRONMENT",
    "FROM_EXPERIMENT",
    "FROM_STRANGER",
    "MAX_COUNT",
    "MAX_TEXT",
    "SURPLUS",
    "TERMINATE",
    "TO_AGENT",
    "TO_ENVIRONMENT",
    "TO_EXPERIMENT",
    "Decoder",
    "Message",
    "Vocabulary",
    "encode",
]

EXPERIMENT: Final = 1
AGENT: Final = 2
ENVIRONMENT: Final = 3
TERMINATE: Final = 35

MAX_COUNT: Final = 1_000_000
"""The most ints, doubles or chars in one abstract type; the original's own limit."""

MAX_TEXT: Final = 1_000_000
"""The most bytes in one text. The original had no limit."""

SURPLUS: Final = 65_536
"""How many bytes a payload may be longer than anything its kind can hold."""

_EMPTY: Final = bytes(16)
_HEADER: Final = struct.Struct(">iI")
_COUNT: Final = struct.Struct(">I")
_THEIR_COUNTS: Final = struct.Struct(">3I")
_OUR_COUNTS: Final = struct.Struct("<4I")
_KINDS_OF_2: Final = frozenset((9, 15, 16, 17, 18, 28, 29, 30, 31, 32))


class Message(NamedTuple):
    """One message; of the fields after `kind`, those that its vocabulary names have a meaning.

    kind         the original's message id
    terminal     int32, 0 or 1 from a sane peer
    reward       a step's reward, or the sum of them for RL_return
    observation  the body of an Observation
    action       the body of an Action
    text         a task spec or a free-form message, without zero bytes; mostly UTF-8
    max_steps    uint32, RL_episode's limit, 0 for none
    number       int32, the answer of RL_num_steps and RL_num_episodes
    """

    kind: int
    terminal: int = 0
    reward: float = 0.0
    observation: bytes = _EMPTY
    action: bytes = _EMPTY
    text: bytes = b""
    max_steps: int = 0
    number: int = 0


class _Piece(NamedTuple):
    """How one field of a message is read from a payload at an offset, and written."""

    read: Callable[[bytes, int], tuple[Any, int]]
    write: Callable[[Any], bytes]
    largest: int


class _Layout(NamedTuple):
    """What a payload holds, in order, and how long it may be."""

    name: str
    pieces: tuple[tuple[str, _Piece], ...]
    limit: int


Vocabulary = Mapping[int, _Layout]
"""The kinds of message that one side may send the other."""


class Decoder:
    """Messages out of one direction of one connection, however the network cut it up.

    Args:
        vocabulary: what may come; give another one with `expect` once more is known of the peer.

    Call `next_event` until it returns None after each `receive_data`; then no more is held than one
    unfinished message, whose size has been checked.
    """

    def __init__(self, vocabulary: Vocabulary) -> None:
        self._vocabulary = vocabulary
        self._buffer = bytearray()
        self._overhang = 0
        self._error: str | None = None

    def expect(self, vocabulary: Vocabulary) -> None:
        """Read what comes from here on by `vocabulary`."""
        self._vocabulary = vocabulary

    def receive_data(self, data: bytes) -> None:
        """Take in bytes as they come from the connection."""
        if self._error is None:
            self._buffer += data

    def next_event(self) -> Message | None:
        """Return the next message, or None until more bytes have come.

        Raises:
            RemoteProtocolError: the bytes are not a message that may come; from then on always.
        """
        if self._error is not None:
            raise RemoteProtocolError(self._error)
        try:
            return self._next()
        except RemoteProtocolError as error:
            self._error = str(error)
            self._buffer.clear()
            raise

    def _next(self) -> Message | None:
        buffer = self._buffer
        if self._overhang:
            self._take_overhang()
        if len(buffer) < _HEADER.size:
            return None
        kind, size = _HEADER.unpack_from(buffer)
        layout = self._vocabulary.get(kind)
        if layout is None:
            raise RemoteProtocolError(_unknown(kind, self._vocabulary))
        if size > layout.limit:
            raise RemoteProtocolError(
                f"a payload of at most {layout.limit} bytes was expected for {layout.name}; "
                f"its header announces {size}"
            )
        end = _HEADER.size + size
        if len(buffer) < end:
            return None
        payload = bytes(buffer[_HEADER.size : end])
        del buffer[:end]
        fields: dict[str, Any] = {}
        offset = 0
        try:
            for field, piece in layout.pieces:
                fields[field], offset = piece.read(payload, offset)
        except RemoteProtocolError as error:
            raise RemoteProtocolError(f"{layout.name}: {error}") from None
        if "text" in fields and offset == size:
            fields["text"] = self._whole(payload[_COUNT.size :])
        return Message(kind, **fields)

    def _whole(self, text: bytes) -> bytes:
        if not text.isascii():
            # A UTF-16 unit takes at most three bytes of UTF-8, one of which has been counted.
            self._overhang = min(2 * len(text), MAX_TEXT - len(text))
            text += self._take_overhang()
        return _until_zero(text)

    def _take_overhang(self) -> bytes:
        overhang = _until_zero(bytes(self._buffer[: self._overhang]))
        del self._buffer[: len(overhang)]
        # A zero byte begins a frame: no more can hang over.
        self._overhang = 0 if self._buffer else self._overhang - len(overhang)
        return overhang


def encode(message: Message, vocabulary: Vocabulary) -> bytes:
    """Return the frame of `message`.

    Raises:
        LocalProtocolError: `vocabulary` lacks its kind, or a field is more than the format, or an
            original program, can take.
    """
    layout = vocabulary.get(message.kind)
    if layout is None:
        raise LocalProtocolError(_unknown(message.kind, vocabulary))
    try:
        payload = b"".join([piece.write(getattr(message, field)) for field, piece in layout.pieces])
    except (struct.error, LocalProtocolError) as error:
        raise LocalProtocolError(f"{layout.name} cannot be sent: {error}") from None
    return _HEADER.pack(message.kind, len(payload)) + payload


def _unknown(kind: int, vocabulary: Vocabulary) -> str:
    expected = ", ".join(f"{known} ({layout.name})" for known, layout in vocabulary.items())
    hint = "; this one is of RL-Glue 2.x, which is not spoken here" if kind in _KINDS_OF_2 else ""
    return f"a message of kind {expected} was expected; kind {kind} came{hint}"


def _scalar(form: str) -> _Piece:
    packer = struct.Struct(form)

    def read(payload: bytes, offset: int) -> tuple[Any, int]:
        try:
            (value,) = packer.unpack_from(payload, offset)
        except struct.error:
            raise _short(packer.size, payload, offset) from None
        return value, offset + packer.size

    return _Piece(read, packer.pack, packer.size)


def _read_text(payload: bytes, offset: int) -> tuple[bytes, int]:
    start = offset + _COUNT.size
    if start > len(payload):
        raise _short(_COUNT.size, payload, offset)
    (count,) = _COUNT.unpack_from(payload, offset)
    if count > MAX_TEXT:
        raise RemoteProtocolError(f"a text has at most {MAX_TEXT} bytes; {count} are announced")
    if start + count > len(payload):
        raise _short(count, payload, start)
    return _until_zero(payload[start : start + count]), start + count


def _write_text(text: bytes) -> bytes:
    text = _until_zero(text)
    if len(text) > MAX_TEXT:
        raise LocalProtocolError(f"a text has at most {MAX_TEXT} bytes; this one has {len(text)}")
    return _COUNT.pack(len(text)) + text


def _until_zero(text: bytes) -> bytes:
    return text.partition(b"\0")[0]


def _read_body(payload: bytes, offset: int) -> tuple[bytes, int]:
    at_ints = offset + _THEIR_COUNTS.size
    if at_ints > len(payload):
        raise _short(_THEIR_COUNTS.size, payload, offset)
    ints, doubles, chars = counts = _THEIR_COUNTS.unpack_from(payload, offset)
    if max(counts) > MAX_COUNT:
        raise RemoteProtocolError(_too_many(counts))
    at_doubles = at_ints + 4 * ints
    at_chars = at_doubles + 8 * doubles
    end = at_chars + chars
    if end > len(payload):
        raise _short(end - at_ints, payload, at_ints)
    body = (
        _OUR_COUNTS.pack(ints, doubles, chars, 0),
        _reversed("q", payload[at_doubles:at_chars]),
        _reversed("i", payload[at_ints:at_doubles]),
        payload[at_chars:end],
    )
    return b"".join(body), end


def _write_body(body: bytes) -> bytes:
    ints, doubles, chars, _ = _OUR_COUNTS.unpack_from(body)
    if max(ints, doubles, chars) > MAX_COUNT:
        raise LocalProtocolError(_too_many((ints, doubles, chars)))
    at_ints = _OUR_COUNTS.size + 8 * doubles
    at_chars = at_ints + 4 * ints
    if at_chars + chars != len(body):
        raise LocalProtocolError(
            f"an abstract type of {at_chars + chars} bytes by its counts is in a body of {len(body)} bytes"
        )
    return b"".join(
        (
            _THEIR_COUNTS.pack(ints, doubles, chars),
            _reversed("i", body[at_ints:at_chars]),
            _reversed("q", body[_OUR_COUNTS.size : at_ints]),
            body[at_chars:],
        )
    )


def _reversed(typecode: str, run: bytes) -> bytes:
    """Return `run` with the bytes of each 4-byte ("i") or 8-byte ("q") number reversed."""
    # Twice as fast as NumPy for the few numbers of most observations, and no slower for many.
    numbers = array(typecode)
    numbers.frombytes(run)
    numbers.byteswap()
    return numbers.tobytes()


def _too_many(counts: tuple[int, int, int]) -> str:
    shown = "{} ints, {} doubles, {} chars".format(*counts)
    return f"an original program takes at most {MAX_COUNT} of each in an abstract type; {shown} came"


def _short(needed: int, payload: bytes, offset: int) -> RemoteProtocolError:
    left = len(payload) - offset
    return RemoteProtocolError(f"{needed} more bytes were expected at byte {offset}; {left} are left")


_BODY: Final = _Piece(_read_body, _write_body, _THEIR_COUNTS.size + (4 + 8 + 1) * MAX_COUNT)
_PIECES: Final = {
    "terminal": _scalar(">i"),
    "reward": _scalar(">d"),
    "observation": _BODY,
    "action": _BODY,
    "text": _Piece(_read_text, _write_text, _COUNT.size + MAX_TEXT),
    "max_steps": _scalar(">I"),
    "number": _scalar(">i"),
}


def _vocabulary(*calls: tuple[int, str, str]) -> Vocabulary:
    layouts = {}
    for kind, name, fields in calls:
        pieces = tuple((field, _PIECES[field]) for field in fields.split())
        layouts[kind] = _Layout(name, pieces, SURPLUS + sum(piece.largest for _, piece in pieces))
    return layouts


FROM_STRANGER: Final = _vocabulary(
    (EXPERIMENT, "experiment connection", ""),
    (AGENT, "agent connection", ""),
    (ENVIRONMENT, "environment connection", ""),
)
TO_AGENT: Final = _vocabulary(
    (4, "agent_init", "text"),
    (5, "agent_start", "observation"),
    (6, "agent_step", "reward observation"),
    (7, "agent_end", "reward"),
    (8, "agent_cleanup", ""),
    (10, "agent_message", "text"),
    (TERMINATE, "terminate", ""),
)
FROM_AGENT: Final = _vocabulary(
    (4, "agent_init", ""),
    (5, "agent_start", "action"),
    (6, "agent_step", "action"),
    (7, "agent_end", ""),
    (8, "agent_cleanup", ""),
    (10, "agent_message", "text"),
    (TERMINATE, "terminate", ""),
)
TO_ENVIRONMENT: Final = _vocabulary(
    (11, "env_init", ""),
    (12, "env_start", ""),
    (13, "env_step", "action"),
    (14, "env_cleanup", ""),
    (19, "env_message", "text"),
    (TERMINATE, "terminate", ""),
)
FROM_ENVIRONMENT: Final = _vocabulary(
    (11, "env_init", "text"),
    (12, "env_start", "observation"),
    (13, "env_step", "terminal reward observation"),
    (14, "env_cleanup", ""),
    (19, "env_message", "text"),
    (TERMINATE, "terminate", ""),
)
FROM_EXPERIMENT: Final = _vocabulary(
    (20, "RL_init", ""),
    (21, "RL_start", ""),
    (22, "RL_step", ""),
    (23, "RL_cleanup", ""),
    (24, "RL_return", ""),
    (25, "RL_num_steps", ""),
    (26, "RL_num_episodes", ""),
    (27, "RL_episode", "max_steps"),
    (33, "RL_agent_message", "text"),
    (34, "RL_env_message", "text"),
    (TERMINATE, "terminate", ""),
    (36, "RL_env_start", ""),
    (37, "RL_env_step", "action"),
    (38, "RL_agent_start", "observation"),
    (39, "RL_agent_step", "reward observation"),
    (40, "RL_agent_end", "reward"),
)
TO_EXPERIMENT: Final = _vocabulary(
    (20, "RL_init", "text"),
    (21, "RL_start", "observation action"),
    (22, "RL_step", "terminal reward observation action"),
    (23, "RL_cleanup", ""),
    (24, "RL_return", "reward"),
    (25, "RL_num_steps", "number"),
    (26, "RL_num_episodes", "number"),
    (27, "RL_episode", "terminal"),
    (33, "RL_agent_message", "text"),
    (34, "RL_env_message", "text"),
    (TERMINATE, "terminate", ""),
    (36, "RL_env_start", "observation"),
    (37, "RL_env_step", "terminal reward observation"),
    (38, "RL_agent_start", "action"),
    (39, "RL_agent_step", "action"),
    (40, "RL_agent_end", ""),
)
