"""The original binary format: round trips and malformed input; recordings are in test_legacy_captures.py."""

from __future__ import annotations

import struct
from collections.abc import Iterator

import numpy as np
import pytest
from hypothesis import HealthCheck, assume, example, given, settings
from hypothesis import strategies as st

from glue.errors import LocalProtocolError, RemoteProtocolError
from glue.legacy.bodies import MAX_COUNT, MAX_STRING
from glue.legacy.codec import FROM, HANDSHAKE, SURPLUS, TO, Decoder, Frame, Vocabulary, encode
from glue.types import Action, Observation
from glue.wire.messages import Body, Kind, Role
from tests.memory import taking_less_than
from tests.proof import size

VOCABULARIES = (HANDSHAKE, *FROM.values(), *TO.values())
pytestmark = pytest.mark.proof

some = settings(max_examples=size(15, 1000), suppress_health_check=[HealthCheck.too_slow])


def raw(kind: int, payload: bytes = b"") -> bytes:
    return struct.pack(">iI", kind, len(payload)) + payload


def text_of(text: bytes) -> bytes:
    return struct.pack(">I", len(text)) + text


def events(decoder: Decoder) -> Iterator[Frame]:
    while (message := decoder.next_event()) is not None:
        yield message


def decode(data: bytes, vocabulary: Vocabulary) -> list[Frame]:
    decoder = Decoder(vocabulary)
    decoder.receive_data(data)
    return list(events(decoder))


# Round trips


@some
@given(
    ints=st.lists(st.integers(0, 2**32 - 1), max_size=5),
    doubles=st.lists(st.integers(0, 2**64 - 1), max_size=5),
    chars=st.binary(max_size=5),
)
@example(ints=[0x80000000], doubles=[0x7FF4000000000001, 0xFFF8DEADBEEF0001, 1 << 63], chars=b"\0\xff")
def test_an_abstract_type_keeps_every_bit_in_the_original_order(
    ints: list[int], doubles: list[int], chars: bytes
) -> None:
    theirs = (
        struct.pack(">3I", len(ints), len(doubles), len(chars))
        + struct.pack(f">{len(ints)}I{len(doubles)}Q", *ints, *doubles)
        + chars
    )
    (message,) = decode(raw(5, theirs), FROM[Role.AGENT])
    action = Action.from_body(message.body)
    assert action.ints.view("uint32").tolist() == ints
    assert action.doubles.view("uint64").tolist() == doubles
    assert action.chars == chars
    assert encode(message, FROM[Role.AGENT]) == raw(5, theirs)


@pytest.mark.parametrize("terminal", [1, 2, -1])
def test_any_terminal_but_zero_is_taken_for_true(terminal: int) -> None:
    payload = struct.pack(">id3I", terminal, 0.5, 0, 0, 0)
    (message,) = decode(raw(13, payload), FROM[Role.ENVIRONMENT])
    assert message.scalars == (0.5, True)


def test_a_limit_of_steps_is_unsigned() -> None:
    (message,) = decode(raw(27, b"\xff\xff\xff\xff"), FROM[Role.EXPERIMENT])
    assert message.scalars == (2**32 - 1,)


def test_the_vocabularies_are_the_originals() -> None:
    assert sorted(HANDSHAKE) == [1, 2, 3]
    assert sorted(FROM[Role.AGENT]) == sorted(TO[Role.AGENT]) == [4, 5, 6, 7, 8, 10, 35]
    assert sorted(FROM[Role.ENVIRONMENT]) == sorted(TO[Role.ENVIRONMENT]) == [11, 12, 13, 14, 19, 35]
    assert sorted(FROM[Role.EXPERIMENT]) == sorted(TO[Role.EXPERIMENT]) == [*range(20, 28), *range(33, 41)]


def test_a_million_of_each_is_accepted() -> None:
    body = Observation(np.full(MAX_COUNT, 7), np.full(MAX_COUNT, 0.5), b"c" * MAX_COUNT).body
    message = Frame(Kind.ENV_START, body=body)
    assert decode(encode(message, FROM[Role.ENVIRONMENT]), FROM[Role.ENVIRONMENT]) == [message]


# Texts


@pytest.mark.parametrize("text", [b"", b"one", "déjà vu 漢字 🎲".encode(), b"caf\xe9"])
def test_texts_with_the_right_count_arrive_whole(text: bytes) -> None:
    stream = raw(33, text_of(text)) + raw(22)
    assert decode(stream, FROM[Role.EXPERIMENT]) == [
        Frame(Kind.RL_AGENT_MESSAGE, body=text),
        Frame(Kind.RL_STEP),
    ]


def test_a_zero_byte_ends_a_text_in_both_directions() -> None:
    assert decode(raw(10, text_of(b"cut\0off")), FROM[Role.AGENT]) == [Frame(Kind.AGENT_MESSAGE, body=b"cut")]
    assert encode(Frame(Kind.AGENT_MESSAGE, body=b"cut\0off"), TO[Role.AGENT]) == raw(10, text_of(b"cut"))


def java_frame(kind: int, text: str) -> bytes:
    """Return a message with a text as Java sends it: counted in UTF-16 units, sent as UTF-8."""
    units = len(text.encode("utf-16-be")) // 2
    return struct.pack(">iII", kind, 4 + units, units) + text.encode()


@some
@given(st.lists(st.text(st.characters(blacklist_characters="\0", codec="utf-8")), max_size=4))
@example(["é", "漢字", "🎲", "", "plain"])
def test_texts_that_java_counted_in_utf16_units_arrive_whole(texts: list[str]) -> None:
    stream = b"".join(java_frame(33, text) for text in texts)
    assert decode(stream, FROM[Role.EXPERIMENT]) == [
        Frame(Kind.RL_AGENT_MESSAGE, body=text.encode()) for text in texts
    ]


@some
@given(st.text(st.characters(blacklist_characters="\0", codec="utf-8")), st.data())
def test_the_end_of_a_java_text_that_comes_late_is_dropped(text: str, data: st.DataObject) -> None:
    assume(not text.isascii())
    stream = java_frame(10, text)
    cut = data.draw(st.integers(8 + 4 + len(text.encode("utf-16-be")) // 2, len(stream)))
    decoder = Decoder(FROM[Role.AGENT])
    decoder.receive_data(stream[:cut])
    assert decoder.next_event() == Frame(Kind.AGENT_MESSAGE, body=stream[12:cut])
    for byte in stream[cut:] + raw(7):
        assert decoder.next_event() is None
        decoder.receive_data(bytes([byte]))
    assert decoder.next_event() == Frame(Kind.AGENT_END)


def test_a_zero_in_a_java_text_cuts_it_and_its_end_does_not_follow() -> None:
    assert decode(java_frame(33, "é\0bc") + raw(22), FROM[Role.EXPERIMENT]) == [
        Frame(Kind.RL_AGENT_MESSAGE, body="é".encode()),
        Frame(Kind.RL_STEP),
    ]


def test_only_a_text_that_fills_its_frame_can_have_an_end_behind_it() -> None:
    with pytest.raises(RemoteProtocolError, match="kind"):
        decode(raw(33, text_of("é".encode()) + b"surplus") + b"\xa9" + raw(22), FROM[Role.EXPERIMENT])


def test_once_another_message_has_begun_no_end_of_a_text_is_expected() -> None:
    decoder = Decoder(FROM[Role.EXPERIMENT])
    decoder.receive_data(raw(33, text_of("éé".encode())) + raw(22))
    assert [message.kind for message in events(decoder)] == [Kind.RL_AGENT_MESSAGE, Kind.RL_STEP]
    decoder.receive_data(b"\xa9" + raw(22))
    with pytest.raises(RemoteProtocolError, match="kind"):
        decoder.next_event()


def test_the_end_of_a_text_is_not_expected_after_a_whole_message() -> None:
    decoder = Decoder(FROM[Role.AGENT])
    decoder.receive_data(raw(10, text_of("é".encode())))
    assert [message.kind for message in events(decoder)] == [Kind.AGENT_MESSAGE]
    assert decoder.overhang
    assert decoder.answer(raw(7), Kind.AGENT_END) is None  # it would not end the wait for the end
    decoder.receive_data(raw(7) + b"\xa9" + raw(7))
    assert decoder.next_event() == Frame(Kind.AGENT_END)
    with pytest.raises(RemoteProtocolError, match="kind"):
        decoder.next_event()


def test_a_text_may_have_a_million_bytes_and_not_one_more() -> None:
    (message,) = decode(raw(11, text_of(b"x" * MAX_STRING)), FROM[Role.ENVIRONMENT])
    assert message.body == b"x" * MAX_STRING
    with pytest.raises(RemoteProtocolError, match="at most 1000000 bytes"):
        decode(raw(11, text_of(b"x" * (MAX_STRING + 1))), FROM[Role.ENVIRONMENT])


# Malformed input


def payloads() -> Iterator[tuple[Vocabulary, int, bytes]]:
    some = Observation([1, 2], [0.5], b"abc").body
    sample = {
        Body.NONE: b"",
        Body.OBSERVATION: some,
        Body.ACTION: some,
        Body.OBSERVATION_ACTION: some + some,
        Body.TEXT: b"text",
    }
    for vocabulary in VOCABULARIES:
        for kind, layout in vocabulary.items():
            scalars = tuple(of_type(1) for of_type in layout.types)
            yield vocabulary, kind, encode(Frame(layout.kind, scalars, sample[layout.body]), vocabulary)[8:]


def test_a_payload_cut_short_anywhere_is_an_error() -> None:
    for vocabulary, kind, payload in payloads():
        for end in range(len(payload)):
            with pytest.raises(RemoteProtocolError, match="more bytes were expected"):
                decode(raw(kind, payload[:end]), vocabulary)


def test_surplus_payload_is_ignored() -> None:
    for vocabulary, kind, payload in payloads():
        plain = decode(raw(kind, payload), vocabulary)
        assert decode(raw(kind, payload + bytes(SURPLUS)), vocabulary) == plain


@pytest.mark.parametrize("counts", [(MAX_COUNT + 1, 0, 0), (0, MAX_COUNT + 1, 0), (0, 0, MAX_COUNT + 1)])
def test_a_count_above_a_million_is_refused(counts: tuple[int, int, int]) -> None:
    with pytest.raises(RemoteProtocolError, match="1000001"):
        decode(raw(12, struct.pack(">3I", *counts) + bytes(9_000_000)), FROM[Role.ENVIRONMENT])


@pytest.mark.parametrize(
    ("vocabulary", "data"),
    [
        (FROM[Role.ENVIRONMENT], raw(12, struct.pack(">3I", 2**32 - 1, 2**32 - 1, 2**32 - 1))),
        (FROM[Role.ENVIRONMENT], raw(12, struct.pack(">3I", MAX_COUNT, MAX_COUNT, MAX_COUNT))),
        (FROM[Role.EXPERIMENT], raw(33, struct.pack(">I", 2**32 - 1))),
        (FROM[Role.EXPERIMENT], raw(33, struct.pack(">I", MAX_STRING))),
        (FROM[Role.ENVIRONMENT], struct.pack(">iI", 12, 2**32 - 1)),
        (FROM[Role.ENVIRONMENT], struct.pack(">iI", 12, 2**31)),
        (HANDSHAKE, struct.pack(">iI", 2, 2**20)),
    ],
)
def test_giant_counts_and_sizes_are_refused_without_allocating(vocabulary: Vocabulary, data: bytes) -> None:
    with taking_less_than(100_000), pytest.raises(RemoteProtocolError):
        decode(data, vocabulary)


def test_a_size_is_refused_from_the_header_alone_as_soon_as_it_passes_the_limit() -> None:
    for vocabulary in VOCABULARIES:
        for kind, layout in vocabulary.items():
            assert decode(struct.pack(">iI", kind, layout.limit), vocabulary) == []
            with pytest.raises(RemoteProtocolError, match=layout.kind.name):
                decode(struct.pack(">iI", kind, layout.limit + 1), vocabulary)


@pytest.mark.parametrize("kind", [0, -1, 5, 41, 99, 2**31 - 1, 9, 15, 18, 28, 32])
def test_a_kind_that_may_not_come_is_refused(kind: int) -> None:
    of_version_2 = r"; it belongs to RL-Glue 2\.x.*" if kind in (9, 15, 18, 28, 32) else ""
    with pytest.raises(RemoteProtocolError, match=f"received kind {kind}{of_version_2}$"):
        decode(raw(kind), FROM[Role.ENVIRONMENT])


def test_after_an_error_the_decoder_stays_in_error_and_keeps_nothing() -> None:
    decoder = Decoder(FROM[Role.AGENT])
    decoder.receive_data(raw(99))
    with pytest.raises(RemoteProtocolError) as first:
        decoder.next_event()
    decoder.receive_data(raw(7))
    with pytest.raises(RemoteProtocolError) as second:
        decoder.next_event()
    assert str(first.value) == str(second.value)
    assert decoder.answer(raw(7), Kind.AGENT_END) is None


# What cannot be sent


def test_a_kind_outside_the_vocabulary_cannot_be_sent() -> None:
    with pytest.raises(LocalProtocolError, match="AGENT_START"):
        encode(Frame(Kind.ENV_STEP), TO[Role.AGENT])


def test_more_than_an_original_program_takes_cannot_be_sent() -> None:
    with pytest.raises(LocalProtocolError, match="1000001 chars"):
        encode(Frame(Kind.AGENT_START, body=Observation(chars=bytes(MAX_COUNT + 1)).body), TO[Role.AGENT])
    with pytest.raises(LocalProtocolError, match="AGENT_MESSAGE"):
        encode(Frame(Kind.AGENT_MESSAGE, body=b"x" * (MAX_STRING + 1)), TO[Role.AGENT])
    with pytest.raises(LocalProtocolError, match="RL_NUM_STEPS"):
        encode(Frame(Kind.RL_NUM_STEPS, (2**31,)), TO[Role.EXPERIMENT])


def test_a_body_that_contradicts_its_counts_cannot_be_sent() -> None:
    body = Observation([1]).body
    for wrong in (b"", body[:-1], body + b"x"):
        with pytest.raises(LocalProtocolError, match="AGENT_START"):
            encode(Frame(Kind.AGENT_START, body=wrong), TO[Role.AGENT])
