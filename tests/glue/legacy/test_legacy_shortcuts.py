"""The gateway's codec reads and writes the same however frames arrive, and whatever was read before.

Each case is a random conversation with any fault. A frame that arrives whole takes a shorter way than one in
pieces, and so does an abstract type that was read or written just before.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import partial
from itertools import product
from random import Random
from typing import Any

import pytest

from glue.errors import LocalProtocolError, RemoteProtocolError
from glue.legacy import bodies
from glue.legacy.codec import FROM, TO, Decoder, Frame, Layout, Vocabulary, encode
from glue.wire.messages import Body, Role, Value
from tests.glue.legacy.conversations import REWARDS, TYPES, conversation
from tests.proof import size

VOCABULARIES = (*FROM.values(), *TO.values())

pytestmark = pytest.mark.proof


def remember(known: bytes) -> None:
    """Let the codec know an abstract type of its own making, or none."""
    for each in (bodies._OBSERVATION, bodies._ACTION):
        each.latest = bodies._Type.latest
        if known:
            each.write(known)


def outcome(work: Callable[[], Any]) -> str:
    """Return what comes of `work`, a value or an error."""
    try:
        return repr(work())
    except (LocalProtocolError, RemoteProtocolError) as error:
        return repr(error)


def reading(
    pieces: Iterable[bytes],
    vocabulary: Vocabulary,
    max_body: int,
    known: Callable[[], bytes],
    shortcut: bool = True,
) -> list[str]:
    """Return the events of a decoder, up to the first error, and the number of bytes left in it."""
    decoder = Decoder(vocabulary, max_body)
    answers = shortcut and vocabulary in (FROM[Role.AGENT], FROM[Role.ENVIRONMENT])
    kinds = [layout.kind for layout in vocabulary.values()] if answers else []
    found: list[str] = []
    for piece in pieces:
        remember(known())
        for kind in kinds:
            if (answer := decoder.answer(piece, kind)) is not None:
                found.append(repr(Frame(kind, *answer)))
                break
        else:
            decoder.receive_data(piece)
        while (event := outcome(decoder.next_event)) != "None":
            found.append(event)
            if "Error" in event:
                return [*found, str(decoder.buffered)]
            remember(known())
    return [*found, str(decoder.buffered)]


def body_of(random: Random, content: Body) -> bytes:
    """Return a body, now and then one that its counts contradict."""
    body = {
        Body.NONE: b"",
        Body.OBSERVATION_ACTION: random.choice(TYPES) + random.choice(TYPES),
        Body.TEXT: random.choice([b"", b"text", b"cut\0off"]),
    }.get(content, random.choice(TYPES))
    if random.random() < 0.1:
        at = random.randrange(len(body) + 1)
        other = random.choice(TYPES)
        return random.choice([body[:at], body + b"x", body[:at] + other[at:], body + other, other + body])
    return body


def scalars_of(random: Random, layout: Layout) -> tuple[Value, ...]:
    wholes = (0, 1, 2, 2**31 - 1, 2**31)
    chosen = {float: REWARDS, bool: (False, True, 2), int: wholes}
    return tuple(random.choice(chosen[of_type]) for of_type in layout.types)


def test_frames_are_read_alike_whole_and_cut_anywhere_and_whatever_was_read_before() -> None:
    for seed in range(size(150, 20_000)):
        random = Random(seed)
        vocabulary = random.choice(VOCABULARIES)
        max_body = random.choice([16, 30, 2**24])
        frames = list(conversation(random, vocabulary))
        data = b"".join(frames)
        expected = reading([bytes([byte]) for byte in data], vocabulary, max_body, bytes, shortcut=False)
        heads_apart = [part for frame in frames for part in (frame[:8], frame[8:]) if part]
        for known in (bytes, partial(random.choice, TYPES)):
            for pieces in (frames, heads_apart):
                assert reading(pieces, vocabulary, max_body, known) == expected, f"conversation {seed}"
            for cut in range(len(data) + 1):
                read = reading([data[:cut], data[cut:]], vocabulary, max_body, known)
                assert read == expected, f"conversation {seed}, cut at {cut}"


def test_frames_are_written_alike_whatever_was_written_before_and_read_back() -> None:
    for seed in range(size(1000, 100_000)):
        random = Random(seed)
        vocabulary = random.choice(VOCABULARIES)
        layout = random.choice(list(vocabulary.values()))
        frame = Frame(layout.kind, scalars_of(random, layout), body_of(random, layout.body))
        remember(b"")
        expected = outcome(partial(encode, frame, vocabulary))
        for known in TYPES:
            remember(known)
            assert outcome(partial(encode, frame, vocabulary)) == expected, f"frame {seed}"
        if "Error" not in expected:
            scalars = tuple(
                of_type(value) for of_type, value in zip(layout.types, frame.scalars, strict=True)
            )
            sent = {Body.NONE: b"", Body.TEXT: frame.body.partition(b"\0")[0]}.get(layout.body, frame.body)
            read = reading([encode(frame, vocabulary)], vocabulary, 2**24, bytes)
            assert read == [repr(Frame(layout.kind, scalars, sent)), "0"], f"frame {seed}"


def test_an_observation_and_an_action_are_written_alike_together_and_one_by_one() -> None:
    two = bodies.BODIES[Body.OBSERVATION_ACTION]
    for observation, action in product(TYPES, repeat=2):
        both = observation + action
        for body in (b"", observation, both, both[:-1], both[1:]):
            remember(b"")
            expected = outcome(partial(two.write, body))
            for known, last in product(TYPES, repeat=2):
                bodies._OBSERVATION.write(known)
                bodies._ACTION.write(last)
                assert outcome(partial(two.write, body)) == expected
