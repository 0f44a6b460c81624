"""Both ends of a connection: steps are recognised by their bytes, which changes nothing but speed."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from glue.types import CUT_OFF, Action, Observation
from glue.wire import zmtp
from glue.wire.codec import FROM_HUB, TO_HUB, encode
from glue.wire.messages import Kind, Message
from glue.wire.stream import Stream
from tests.glue.wire.test_learned import connected, reported

BODY = bytes(Observation([1, 2], [0.5], b"abc").body)
LONG = bytes(Action(range(100)).body)
NUMBERS = [1, 127, 128, 255, 256, 65_535, 65_536, 2**32 - 1]
"""Both ends of each form that msgpack has for an integer, as far as there is a format."""

SHAPES: list[tuple[Kind, bool, tuple[float | bool, ...]]] = [
    (Kind.ENV_STEP, True, ()),
    (Kind.ENV_STEP, False, (-0.25, True)),
    (Kind.ENV_STEP, False, (1.0, CUT_OFF)),
    (Kind.AGENT_STEP, True, (-0.25,)),
    (Kind.AGENT_STEP, False, ()),
]
"""A kind, whether the hub sends it, and its scalars."""

every_step = pytest.mark.parametrize(("kind", "from_hub", "scalars"), SHAPES)


def acquainted(kind: Kind, from_hub: bool, *sessions: str) -> tuple[Stream, Stream]:
    """Return the sender and the receiver of a message of `kind`, which know its format in these sessions."""
    hub, peer, *_ = connected(2**20)
    for session in sessions:
        hub.encode(Message(kind, session, 1, (1.0,) if kind is Kind.AGENT_STEP else (), BODY))
        peer.encode(Message(kind, session, 1, (1.0, False) if kind is Kind.ENV_STEP else (), BODY))
    return (hub, peer) if from_hub else (peer, hub)


def plainly(message: Message, from_hub: bool) -> bytes:
    """Return the bytes of a message as the codec encodes it."""
    return zmtp.encode(encode(message, FROM_HUB if from_hub else TO_HUB))


class CodecUsed(Exception):
    pass


def _refuse(*_: object) -> None:
    raise CodecUsed


@pytest.fixture
def without_codec(monkeypatch: pytest.MonkeyPatch) -> Callable[[], None]:
    """A function that disables the codec of all streams."""

    def take_away() -> None:
        monkeypatch.setattr("glue.wire.stream.encode", _refuse)
        monkeypatch.setattr("glue.wire.stream.decode", _refuse)

    return take_away


@every_step
@pytest.mark.parametrize("body", [BODY, LONG, bytes(Observation(chars=bytes(239)).body)], ids=len)
@pytest.mark.parametrize("sessions", [("s",), ("", "t", "n" * 31)], ids=len)
def test_usual_steps_are_those_of_the_codec_and_need_none(
    kind: Kind,
    from_hub: bool,
    scalars: tuple[float | bool, ...],
    body: bytes,
    sessions: tuple[str, ...],
    without_codec: Callable[[], None],
) -> None:
    sender, receiver = acquainted(kind, from_hub, *sessions)
    receiver.max_body = len(body)
    without_codec()
    for session in sessions:
        for seq in NUMBERS:
            message = Message(kind, session, seq, scalars, body)
            data = b"".join(sender.encode(message))
            assert data == plainly(message, from_hub)
            for times in (1, 2):
                receiver.receive_data(times * data)
                assert reported(receiver) == [repr(message)] * times
            assert receiver.empty
            assert receiver.buffered == 0


def test_a_step_behind_pieces_of_another_message_needs_no_codec(without_codec: Callable[[], None]) -> None:
    _, receiver = acquainted(Kind.ENV_STEP, False, "s")
    beat = Message(Kind.HEARTBEAT, "s", 0)
    step = Message(Kind.ENV_STEP, "s", 2, (1.0, False), LONG)
    data = plainly(beat, False) + plainly(step, False)
    for piece in (data[:1], data[1:40], data[40:]):
        receiver.receive_data(piece)
    assert receiver.next_event() == beat
    without_codec()
    assert receiver.buffered == len(plainly(step, False))
    assert receiver.next_event() == step
    assert receiver.empty


def test_what_was_read_counts_as_kept_until_the_rest_is_read_too() -> None:
    sender, receiver = acquainted(Kind.ENV_STEP, False, "s")
    step = b"".join(sender.encode(Message(Kind.ENV_STEP, "s", 300, (1.0, False), BODY)))
    data = 3 * step + step[:10]
    receiver.receive_data(data)
    for _ in range(3):
        assert isinstance(receiver.next_event(), Message)
        assert receiver.kept == len(data)
    assert receiver.next_event() is None
    assert receiver.kept == receiver.buffered == 10
