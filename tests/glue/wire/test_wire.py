"""Messages to frames and back; any other input is refused before it costs anything."""

from __future__ import annotations

import struct
from collections.abc import Mapping
from typing import Any

import msgpack
import pytest
from hypothesis import given
from hypothesis import strategies as st

from glue.errors import LocalProtocolError, RemoteProtocolError
from glue.types import Action, Observation
from glue.wire.codec import FROM_HUB, TO_HUB, UnknownKind, clip, decode, encode
from glue.wire.messages import MAX_HEADER, Body, Kind, Message, Scalar, Shape

int32s = st.lists(st.integers(-(2**31), 2**31 - 1), max_size=5)
doubles = st.lists(st.floats(), max_size=5)
observations = st.builds(Observation, int32s, doubles, st.binary(max_size=9))
actions = st.builds(Action, int32s, doubles, st.binary(max_size=9))
bodies: dict[Body, st.SearchStrategy[bytes]] = {
    Body.NONE: st.just(b""),
    Body.OBSERVATION: observations.map(lambda o: o.body),
    Body.ACTION: actions.map(lambda a: a.body),
    Body.OBSERVATION_ACTION: st.builds(lambda o, a: o.body + a.body, observations, actions),
    Body.TEXT: st.text(max_size=30).map(str.encode),
    Body.BLOB: st.binary(max_size=30),
}
numbers = st.integers(0, 2**63 - 1)
scalars: dict[type, st.SearchStrategy[Any]] = {
    bool: st.booleans(),
    bytes: st.binary(max_size=20),
    float: st.floats(),
    int: numbers,
    str: st.text(max_size=20),
}


def scalar_values(scalar: Scalar) -> st.SearchStrategy[Any]:
    if scalar.items is not None:
        return st.lists(scalars[scalar.items], max_size=8).map(tuple)
    return scalars[scalar.type] | st.none() if scalar.optional else scalars[scalar.type]


@st.composite
def messages(draw: st.DrawFn, shapes: Mapping[Kind, Shape]) -> Message:
    """Any legal message in the direction of `shapes`."""
    kind = draw(st.sampled_from(sorted(shapes)))
    shape = shapes[kind]
    values = tuple(draw(scalar_values(scalar)) for scalar in shape.scalars)
    session = draw(st.text(max_size=20))
    return Message(kind, session, draw(numbers), values, draw(bodies[shape.body]))


def header(*values: Any) -> bytes:
    packed: bytes = msgpack.packb(values)
    return packed


def env_step(
    reward: Any = 0.0, terminal: Any = False, body: bytes = Observation().body
) -> tuple[bytes, bytes]:
    """Return the frames of an environment's answer to a step."""
    return header(13, "s", 1, reward, terminal), body


def rejected(*frames: bytes, shapes: Mapping[Kind, Shape] = TO_HUB, **limits: int) -> str:
    """Return the reason why `frames` are refused."""
    with pytest.raises(RemoteProtocolError) as caught:
        decode(frames, shapes, **limits)
    return str(caught.value)


# Round trips


@given(st.one_of([st.tuples(st.just(shapes), messages(shapes)) for shapes in (TO_HUB, FROM_HUB)]))
def test_what_is_sent_arrives_unchanged(sent: tuple[Mapping[Kind, Shape], Message]) -> None:
    shapes, message = sent
    assert repr(decode(encode(message, shapes), shapes)) == repr(message)


def test_a_header_has_at_most_4096_bytes_and_an_array_64_items() -> None:
    versions = header(64, "s", 0, [1] * 64, "agent", bytes(16), "n", "c", [])
    assert decode([versions], TO_HUB).scalars[0] == (1,) * 64
    spare = MAX_HEADER - len(header(68, "s", 0, "x" * 256))
    (longest,) = encode(Message(Kind.GOODBYE, "s", 0, ("x" * (256 + spare),)), TO_HUB)
    assert len(longest) == MAX_HEADER
    assert decode([longest], TO_HUB).kind is Kind.GOODBYE
    with pytest.raises(LocalProtocolError, match="header of GOODBYE would take"):
        encode(Message(Kind.GOODBYE, "s", 0, ("x" * (257 + spare),)), TO_HUB)


# What is refused


BODY = Observation().body
BEAT = header(67, "s", 0)
NO_TERMINALS: list[Any] = [1.0, None, [], {}]


@pytest.mark.parametrize(
    ("frames", "complaint"),
    [
        ((header(13, "s", 1), BODY), "has 2 scalars; 0 received"),
        ((header(13, "s", 1, "1", False), BODY), "reward of ENV_STEP is a number; '1' received"),
        *(
            (
                (header(13, "s", 1, 0.0, terminal), BODY),
                f"terminal of ENV_STEP is true or false; {terminal} re",
            )
            for terminal in NO_TERMINALS
        ),
        *(
            ((header(20, "s", 1, seed),), "a whole number from 0 to 2^63 - 1")
            for seed in (-1, 2**63, 2**64 - 1, 1.0, True, "1", b"1", [1])
        ),
        *(
            ((header(64, "s", 0, versions, "agent", b"i" * 16, "n", "c", abilities),), "an array")
            for versions in ("1", 1, [1.0], [True], [[1]], [1])
            for abilities in (([1], "seed") if versions == [1] else ([],))
        ),
        ((header(13.0, "s", 1),), "a kind is a whole number"),
        ((header(13, b"s", 1),), "a session is a text"),
        ((header(13, "s", None),), "a sequence number"),
        *(((frame,), "a header is an array") for frame in (header(13, "s"), b"\x80")),
        ((b"\x94\x43\xa1s\x00\xd6\xff\x00\x00\x00\x00",), "not msgpack within the limits"),
        *(((BEAT,) * count, f"a message has one or two frames; {count} received") for count in (0, 3, 1000)),
        (env_step()[:1], "ENV_STEP needs a body frame; none received"),
        ((BEAT, b"xx"), "HEARTBEAT has no body; one of 2 bytes was received"),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_what_is_no_message_is_refused_with_what_is_wrong(frames: tuple[bytes, ...], complaint: str) -> None:
    assert complaint in rejected(*frames)


@pytest.mark.parametrize("kind", [0, 3, 9, 63, 79, 255, -1, 2**63, 2**64 - 1])
def test_an_unknown_kind_names_its_session_and_number(kind: int) -> None:
    with pytest.raises(UnknownKind) as caught:
        decode([header(kind, "s", 9)], TO_HUB)
    assert (caught.value.session, caught.value.seq) == ("s", 9)


def counts(ints: int, doubles: int, chars: int, reserved: int = 0) -> bytes:
    return struct.pack("<4I", ints, doubles, chars, reserved)


def test_a_body_is_refused_by_its_size_before_anything_else() -> None:
    assert "101 bytes; 100 are allowed" in rejected(header(19, "s", 1), bytes(101), max_body=100)


def test_an_observation_and_an_action_are_each_within_the_limit() -> None:
    observation, action = Observation(chars=bytes(84)).body, Action(chars=bytes(84)).body
    frames = header(21, "s", 1), observation + action
    assert decode(frames, FROM_HUB, max_body=100).body == observation + action
    assert "are allowed" in rejected(frames[0], frames[1] + b"x", shapes=FROM_HUB, max_body=100)


# Anything at all


def either_refused_or_sound(frames: list[bytes], shapes: Mapping[Kind, Shape]) -> None:
    """Decode frames; a message that is not refused must be fit to be sent on."""
    try:
        message = decode(frames, shapes)
    except RemoteProtocolError:
        return
    assert repr(decode(encode(message, shapes), shapes)) == repr(message)


@given(messages(TO_HUB), st.data())
def test_damaged_messages_are_refused_or_sound(message: Message, data: st.DataObject) -> None:
    whole = list(encode(message, TO_HUB))
    which = data.draw(st.integers(0, len(whole) - 1))
    frame = bytearray(whole[which])
    if frame and data.draw(st.booleans()):
        frame[data.draw(st.integers(0, len(frame) - 1))] ^= 1 << data.draw(st.integers(0, 7))
    else:
        del frame[data.draw(st.integers(0, len(frame))) :]
    whole[which] = bytes(frame)
    either_refused_or_sound(whole, TO_HUB)


# Texts for people


@given(st.text(max_size=40), st.integers(0, 30))
def test_a_clipped_text_is_printable_and_short(text: str, limit: int) -> None:
    clipped = clip(text, limit)
    assert clipped.isprintable()
    assert len(clipped.encode()) <= limit + len("...")


@pytest.mark.parametrize("text", ["", "short", "\N{GRINNING FACE}" * 250, "x" * 1000])
def test_a_text_within_the_limit_is_left_alone(text: str) -> None:
    assert clip(text) == text


def test_a_text_is_clipped_between_characters_and_without_control_characters() -> None:
    assert clip("\N{GRINNING FACE}" * 3, 10) == "\N{GRINNING FACE}" * 2 + "..."
    assert clip("a\nb\x1b[31mc\ud800") == "a b [31mc "


def test_the_greatest_body_has_room_for_a_million_of_each() -> None:
    million = 10**6
    assert decode(env_step(body=counts(million, million, million) + bytes(13 * million)), TO_HUB)
