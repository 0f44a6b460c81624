"""ZMTP without sockets: the same messages however the bytes are cut, and no other errors."""

from __future__ import annotations

import struct
import tracemalloc

import pytest
from hypothesis import given
from hypothesis import strategies as st

from glue.errors import RemoteProtocolError
from glue.wire.zmtp import GREETING, ROUTER, Decoder, encode
from tests.memory import taking_less_than

READY = b"\x04\x1c\x05READY\x0bSocket-Type\x00\x00\x00\x06DEALER"
ANSWER = b"\x04\x1c\x05READY\x0bSocket-Type\x00\x00\x00\x06ROUTER"
MAX_FRAME = 100_000

frames = st.lists(st.binary(max_size=300) | st.just(bytes(MAX_FRAME)), min_size=1, max_size=3)


def events(decoder: Decoder, data: bytes) -> list[list[bytes] | bytes]:
    """Return all events that result from `data`."""
    decoder.receive_data(data)
    found = []
    while (event := decoder.next_event()) is not None:
        if event:
            found.append(event)
    return found


def greeted() -> Decoder:
    """Return a decoder that has met a DEALER."""
    decoder = Decoder(ROUTER, MAX_FRAME)
    assert events(decoder, GREETING + READY) == [ANSWER]
    return decoder


def test_the_greeting_is_the_standards() -> None:
    # RFC 37: signature, version 3.1, mechanism, as-server, filler.
    assert len(GREETING) == 64
    assert GREETING[:12] == bytes.fromhex("ff00000000000000007f0301")
    assert GREETING[12:32].rstrip(b"\0") == b"NULL"
    assert GREETING[32:] == bytes(32)


def test_short_and_long_frames() -> None:
    assert encode([b"ab", b""]) == b"\x01\x02ab\x00\x00"
    assert encode([bytes(255)]) == b"\x00\xff" + bytes(255)
    assert encode([bytes(256)]) == b"\x02" + struct.pack(">Q", 256) + bytes(256)
    assert encode([bytes(256), b"x"])[:1] == b"\x03"


@given(st.lists(frames, max_size=4), st.lists(st.integers(1, 2**17), max_size=40))
def test_messages_come_out_as_they_went_in_however_cut(messages: list[list[bytes]], cuts: list[int]) -> None:
    decoder = Decoder(ROUTER, MAX_FRAME)
    data = GREETING + READY + b"".join(map(encode, messages))
    found = []
    for size in [*cuts, len(data)]:
        found += events(decoder, data[:size])
        data = data[size:]
    assert found == [ANSWER, *messages]
    assert decoder.buffered == 0


def test_a_context_that_is_too_long_is_cut_to_16_bytes() -> None:
    assert events(greeted(), b"\x04\x1b\x04PING\x00\x10" + b"c" * 20) == [b"\x04\x15\x04PONG" + b"c" * 16]


def test_the_socket_may_be_said_after_other_properties() -> None:
    other = b"\x08Identity\x00\x00\x00\x05carol" + b"\x01x\x00\x00\x00\x00"
    ready = b"\x05READY" + other + READY[8:]
    decoder = Decoder(ROUTER, MAX_FRAME)
    assert events(decoder, GREETING + bytes((4, len(ready))) + ready) == [ANSWER]
    assert decoder.ready


def test_unknown_commands_are_passed_over() -> None:
    decoder = greeted()
    assert events(decoder, b"\x04\x05\x04PONG" + b"\x04\x02\x01?" + b"\x04\x00" + encode([b"x"])) == [[b"x"]]


def test_of_a_message_of_many_frames_three_are_kept() -> None:
    decoder = greeted()
    assert events(decoder, b"\x01\x01x" * 10_000) == []
    assert decoder.buffered == 6, "three bytes, and one for each frame"
    assert events(decoder, encode([b"y"])) == [[b"x", b"x", b"x"]]


def test_a_frame_that_is_too_large_is_refused_before_it_comes() -> None:
    decoder = greeted()
    with pytest.raises(RemoteProtocolError, match=f"{MAX_FRAME + 1} bytes .* {MAX_FRAME} are"):
        events(decoder, b"\x02" + struct.pack(">Q", MAX_FRAME + 1))


@pytest.mark.parametrize("frame", [b"\x04\x00", b"\x01\x00"], ids=["commands", "frames"])
def test_of_what_comes_to_nothing_a_little_is_taken_at_once(frame: bytes) -> None:
    decoder = greeted()
    decoder.receive_data(frame * 10_000)
    assert decoder.next_event() == b""
    assert decoder.buffered > 19_000


def test_bytes_that_come_in_little_pieces_take_little_more_room_than_at_once() -> None:
    decoder = greeted()
    data = b"\x02" + struct.pack(">Q", MAX_FRAME) + bytes(MAX_FRAME - 1)
    with taking_less_than(2 * MAX_FRAME):
        for at in range(0, len(data), 2):
            assert events(decoder, data[at : at + 2]) == []


def test_the_beginning_of_another_message_does_not_keep_the_one_before() -> None:
    decoder = greeted()
    tracemalloc.start()
    try:
        before, _ = tracemalloc.get_traced_memory()
        assert len(events(decoder, encode([bytes(MAX_FRAME)]) + b"\x00")) == 1
        after, _ = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert decoder.buffered == 1
    assert after - before < MAX_FRAME // 2


def test_what_was_said_is_not_kept() -> None:
    decoder = greeted()
    large = encode([bytes(MAX_FRAME)])
    assert events(decoder, large[:50_000]) == []
    assert decoder.buffered == 50_000
    assert events(decoder, large[50_000:]) == [[bytes(MAX_FRAME)]]
    assert decoder.buffered == 0


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        (GREETING[:10] + b"\2" + GREETING[11:], "ZMTP before 3"),
        (GREETING.replace(b"NULL", b"\x1b[2J"), r"b'\\x1b\[2J'; only NULL"),
        (GREETING + encode([b"early"]), "before READY"),
        (GREETING + b"\x04\x06\x05READY", "does not say what socket"),
        (GREETING + b"\x04\x08\x05READY\x0bS", "does not say what socket"),
        (GREETING + b"\x04\x0c\x05READY\x01x\xff\xff\xff\xfa", "does not say what socket"),
        (
            GREETING + READY.replace(b"DEALER", b"\x1b[2J\n!"),
            r"socket of type b'\\x1b\[2J\\n!', not DEALER",
        ),
        (GREETING + b"\x04\x0c\x05ERROR\x05\x1b[2J\n", r"ended the handshake: b'\\x1b\[2J\\n'"),
    ],
    ids=[
        *("version", "mechanism", "message before READY", "no socket type", "cut property"),
        *("large property", "another socket", "ended"),
    ],
)
def test_a_handshake_that_cannot_be_completed_is_refused_with_its_reason(data: bytes, reason: str) -> None:
    decoder = Decoder(ROUTER, MAX_FRAME)
    with pytest.raises(RemoteProtocolError, match=reason) as raised:
        events(decoder, data)
    assert str(raised.value).isprintable()
