"""A stream that has learned the steps of its sessions reads exactly as one that has not.

Each case is a random conversation, most of it steps, in any encoding and with any fault, received in any
pieces by both streams. They must report the same events after each piece. What they send in between arrives
unchanged at a stream that has learned nothing.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import accumulate, pairwise
from random import Random

import pytest

from glue.errors import RemoteProtocolError
from glue.system import chance
from glue.types import CUT_OFF
from glue.wire import zmtp
from glue.wire.codec import FROM_HUB, TO_HUB, UnknownKind, encode
from glue.wire.curve import CurveClient, CurveServer, public_key
from glue.wire.messages import Kind, Message, Value
from glue.wire.stream import Malformed, Stream
from glue.wire.zmtp import COMMAND, LONG, LONG_HEAD, MORE, head
from tests.proof import size

SESSIONS = ("s", "t", "", "n" * 31, "n" * 32, "ä" * 15, "unknown")
"""Names of sessions; the last one is never learned."""

LARGEST = 2**12
"""The streams' `max_body`, in bytes."""

SECRET = bytes(range(32))
_ENCRYPTED_COMMAND = 2
"""The flag of a command inside an encrypted frame."""

PING = b"\x04PING\0\0context"


def connected(
    max_body: int, keyed: bool = False
) -> tuple[Stream, Stream, CurveServer | None, CurveClient | None]:
    """Return the hub's end and a peer's after their handshake, and the mechanism of each."""
    server, client = None, None
    if keyed:
        server = CurveServer(SECRET, lambda client: True)
        client = CurveClient(public_key(SECRET), SECRET, public_key(SECRET))
    hub = Stream(zmtp.ROUTER, max_body + 4096, max_body, server)
    peer = Stream(zmtp.DEALER, max_body + 4096, max_body, client)
    greetings = (zmtp.CURVE_GREETING, zmtp.CURVE_CLIENT_GREETING) if keyed else (zmtp.GREETING,) * 2
    sent = {id(peer): greetings[0], id(hub): greetings[1]}
    while sent[id(hub)] or sent[id(peer)]:
        for one, other in ((hub, peer), (peer, hub)):
            data, sent[id(one)] = sent[id(one)], b""
            one.receive_data(data)
            while (event := one.next_event()) is not None:
                assert isinstance(event, bytes)
                sent[id(other)] += event
    assert hub.ready
    assert peer.ready
    return hub, peer, server, client


@dataclass
class Line:
    """Both ends of a connection: the sender's encoding of frames, and the receiver.

    Args:
        from_hub: whether the receiver is a peer.
        keyed: whether the connection is encrypted.
    """

    from_hub: bool
    keyed: bool

    def __post_init__(self) -> None:
        hub, peer, server, client = connected(LARGEST, self.keyed)
        self.receiver, self.sender = (peer, hub) if self.from_hub else (hub, peer)
        self.mechanism = server if self.from_hub else client

    def learn(self, kind: Kind, session: str) -> None:
        """Let the receiver learn the formats of a session's steps."""
        self.receiver.encode(Message(kind, session, 1, scalars_of(kind, not self.from_hub), bytes(16)))

    def encoded(self, random: Random, frames: Sequence[bytes], flags: int = 0) -> bytes:
        """Return the bytes of a message, perhaps in an encoding that this project does not write."""
        if self.mechanism is not None:
            data = bytes(self.mechanism.encode(frames, _ENCRYPTED_COMMAND if flags == COMMAND else flags))
            short = data[0] == 0 and random.random() < 0.05
            return LONG_HEAD.pack(LONG, data[1]) + data[2:] if short else data
        parts = []
        for left, frame in zip(range(len(frames))[::-1], frames, strict=True):
            more = MORE if left else flags
            long = random.random() < 0.05
            parts.append(LONG_HEAD.pack(more | LONG, len(frame)) if long else head(more, len(frame)))
            parts.append(frame)
        return b"".join(parts)


def scalars_of(kind: Kind, from_hub: bool, reward: float = 1.0, terminal: Value = False) -> tuple[Value, ...]:
    """Return the scalars of a step."""
    if kind is Kind.ENV_STEP:
        return () if from_hub else (reward, terminal)
    return (reward,) if from_hub else ()


def wholes(number: int) -> list[bytes]:
    """Return a whole number in each of msgpack's forms, the shortest first."""
    forms = [(0xCC, "B", 8), (0xCD, "H", 16), (0xCE, "I", 32), (0xCF, "Q", 64), (0xD3, "q", 63)]
    found = [struct.pack(">B" + form, first, number) for first, form, bits in forms if number < 2**bits]
    return [bytes([number]), *found] if number < 128 else found


def texts(name: bytes) -> list[bytes]:
    """Return a text in each of msgpack's forms, the shortest first."""
    forms = [bytes((0xD9, len(name))) + name, struct.pack(">BH", 0xDA, len(name)) + name]
    return [bytes((0xA0 | len(name),)) + name, *forms] if len(name) < 32 else forms


def values(value: Value) -> list[bytes]:
    """Return a reward or a terminal in each form that a reader accepts, the usual one first."""
    if type(value) is bool:
        return [bytes([0xC2 + value]), bytes([value]), bytes([0xCC, value])]
    if type(value) is not float:
        return [bytes([CUT_OFF])]
    exact = [struct.pack(">Bf", 0xCA, value), *wholes(int(value))] if value == 1 or value == 0 else []
    return [struct.pack(">Bd", 0xCB, value), *exact]


def encodings(message: Message) -> list[list[bytes]]:
    """Return the parts of a header, each in every form that the protocol allows, the usual one first."""
    count = 3 + len(message.scalars)
    return [
        [bytes((0x90 | count,)), struct.pack(">BH", 0xDC, count)],
        wholes(message.kind),
        texts(message.session.encode()),
        wholes(message.seq),
        *map(values, message.scalars),
    ]


def oddly(random: Random, message: Message) -> bytes:
    """Return a header of which one part, or every one, is encoded in any way that the protocol allows."""
    parts = encodings(message)
    odd = random.choice([*range(len(parts)), None])
    return b"".join(
        random.choice(forms) if odd is None or odd == at else forms[0] for at, forms in enumerate(parts)
    )


Size = tuple[int, int, int, int, int]


def body_of(random: Random, shape: Size) -> bytes:
    ints, doubles, chars, mask, extras = shape
    return struct.pack("<3I2H", *shape) + random.randbytes(4 * ints + 8 * doubles + chars + mask + extras)


ODDITIES = [
    *(
        "encoding",
        "encoding",
        "body",
        "body",
        "other",
        "frames",
        "header",
        "moved",
        "again",
        "swapped",
        "ping",
    ),
    "flags",
    "paced",
]
NUMBERS = [0, 1, 120, 127, 128, 250, 256, 2**16 - 2, 2**16, 2**32 - 2, 2**32, 2**63 - 20]
SHAPES: list[Size] = [
    (1, 0, 0, 0, 0),
    (0, 0, 0, 0, 0),
    (2, 1, 3, 0, 0),
    (0, 3, 0, 0, 0),
    (60, 0, 0, 0, 0),
    (0, 29, 7, 0, 0),
    (0, 0, 240, 0, 0),
    (5, 1, 300, 0, 0),
    (0, 0, LARGEST - 16, 0, 0),
    (0, 0, LARGEST - 15, 0, 0),
    (2, 1, 3, 2, 0),
    (1, 0, 0, 2, 40),
    (0, 0, 240, 0, 300),
    (0, 0, 0, 2**16 - 1, 0),
]


def step(random: Random, kind: Kind, from_hub: bool, session: str, number: int, shape: Size) -> Message:
    reward = random.choice([0.0, -0.0, 1.0, 0.1, float("nan"), float("-inf")])
    scalars = scalars_of(kind, from_hub, reward, random.choice([False, True, CUT_OFF]))
    return Message(kind, session, number, scalars, body_of(random, shape))


def wrong_body(random: Random, body: bytes) -> bytes:
    """Return a body whose counts and length disagree, or that is too large."""
    at = random.randrange(16)
    changed = body[:at] + bytes([body[at] ^ random.choice([1, 4, 128])]) + body[at + 1 :]
    return random.choice([body[:-1], body + b"x", body[:15], b"", changed, body + bytes(LARGEST)])


def sent(random: Random, line: Line, kind: Kind) -> Iterator[bytes]:
    """Yield the bytes of the messages of one conversation, most of them steps of a kind."""
    shapes = FROM_HUB if line.from_hub else TO_HUB
    sessions = random.sample(SESSIONS, random.choice([1, 1, 2, len(SESSIONS)]))
    usual, oddities = random.choice(SHAPES), random.choice([0.0, 0.1, 0.5])
    last = b""
    begin = random.choice([100, 200, 2**16 - 2, 2**32 - 8])
    for later in range(random.choice([4, 8, 16])):
        number = begin + later if random.random() < 0.8 else random.choice(NUMBERS)
        shape = usual if random.random() < 0.7 else random.choice(SHAPES)
        message = step(random, kind, line.from_hub, random.choice(sessions), number, shape)
        header, body = encode(message, shapes)
        frames = [header, body]
        match random.choice(ODDITIES) if random.random() < oddities else "":
            case "encoding":
                frames = [oddly(random, message), body]
            case "body":
                frames = [header, wrong_body(random, body)]
            case "other":
                beat = encode(Message(Kind.HEARTBEAT, message.session, message.seq), shapes)
                unknown = bytes((0x93, 99, 0xA1, 0x73, 5))
                frames = random.choice([list(beat), [unknown], [unknown, b"x"]])
            case "frames":
                frames = random.choice([[header], frames * 2, [*frames, b""], [b""]])
            case "header":
                cut = random.randrange(len(header))
                frames = [random.choice([header[:cut], header + b"\0", random.randbytes(12)]), body]
            case "moved":
                at = random.choice([1, 2, len(header) - 1, len(header) + 1, len(header) + 16])
                frames = [(header + body)[:at], (header + body)[at:]]
            case "again":
                yield last
            case "swapped":
                last = line.encoded(random, frames)
                yield line.encoded(random, frames)
            case "ping":
                yield line.encoded(random, [PING], COMMAND)
            case "paced" if kind is Kind.AGENT_STEP and line.from_hub:
                told = message._replace(scalars=(*message.scalars, 0.5, 0.25))
                frames = [encode(told, shapes)[0], body]
            case "flags":
                first = random.choice([b"", header])
                yield line.encoded(random, [first], random.choice([0, MORE]))
                yield line.encoded(random, [body], random.choice([0, MORE]))
        last = line.encoded(random, frames)
        yield last


def pieces(random: Random, messages: Sequence[bytes]) -> Iterator[bytes]:
    """Yield the messages in pieces in which a network might deliver them, with perhaps a byte changed."""
    starts = list(accumulate(map(len, messages), initial=0))
    data = bytearray(b"".join(messages))
    if random.random() < 0.2:
        near = random.choice(starts[:-1]) + random.choice([0, 0, 1, 20])
        at = random.choice([near, random.randrange(len(data))])
        data[min(at, len(data) - 1)] ^= random.choice([1, 2, 4, 128])
    some = sorted(random.choices(range(len(data) + 1), k=5))
    for begin, end in pairwise([0, *random.choice([starts, starts, some, [], range(len(data))]), len(data)]):
        if begin < end:
            yield bytes(data[begin:end])


def events(stream: Stream, data: bytes) -> list[str]:
    """Return what a stream reports of `data`: messages, bytes to be sent, and errors."""
    half = len(data) // 2 if data[-1] % 8 == 0 else 0
    for part in filter(None, (data[:half], data[half:])):
        stream.receive_data(part)
    return reported(stream)


def reported(stream: Stream) -> list[str]:
    """Return what a stream reports of the data that it has received."""
    found: list[str] = []
    while True:
        try:
            event = stream.next_event()
        except (Malformed, UnknownKind) as error:
            found.append(repr(error))
        except RemoteProtocolError as error:
            return [*found, f"the end: {error!r}"]
        else:
            if event is None:
                return found
            if event:
                found.append(repr(event) if isinstance(event, Message) else f"{len(event)} bytes to be sent")


def pair(seed: int, from_hub: bool, keyed: bool) -> list[Line]:
    """Return two connections with the same keys."""
    lines = []
    for _ in range(2):
        with pytest.MonkeyPatch.context() as patched:
            patched.setattr(chance, "random_bytes", Random(seed).randbytes)
            lines.append(Line(from_hub, keyed))
    return lines


def converse(seed: int) -> None:
    """Compare two receivers of one conversation, of which one has learned the steps of most sessions."""
    random = Random(seed)
    from_hub, keyed = random.random() < 0.5, random.random() < 0.5
    plain, learned = pair(seed, from_hub, keyed)
    kind = random.choice([Kind.ENV_STEP, Kind.AGENT_STEP])
    for session in SESSIONS[: random.randrange(1, len(SESSIONS))]:
        learned.learn(kind, session)
    for piece in pieces(random, list(sent(random, plain, kind))):
        if random.random() < 0.1:
            plain.receiver.max_body = learned.receiver.max_body = random.choice([100, LARGEST])
        if random.random() < 0.1:
            learned.receiver.forget(random.choice(SESSIONS))
            learned.learn(kind, random.choice(SESSIONS[:-1]))
        expected = events(plain.receiver, piece)
        assert events(learned.receiver, piece) == expected
        if expected and expected[-1].startswith("the end"):
            return
        assert learned.receiver.buffered == plain.receiver.buffered
        if len(piece) > 20 and random.random() < 0.3:
            answer = step(random, kind, not from_hub, random.choice(SESSIONS), 300, random.choice(SHAPES[:9]))
            assert events(learned.sender, b"".join(learned.receiver.encode(answer))) == [repr(answer)]


@pytest.mark.parametrize("keyed", [False, True], ids=["plain", "keyed"])
@pytest.mark.parametrize("kind", [Kind.ENV_STEP, Kind.AGENT_STEP], ids=str)
@pytest.mark.parametrize("from_hub", [False, True], ids=["to a hub", "from a hub"])
def test_what_differs_in_one_place_from_a_learned_step_is_read_alike(
    from_hub: bool, kind: Kind, keyed: bool
) -> None:
    random = Random(0)
    plain, learned = pair(0, from_hub, keyed)
    learned.learn(kind, "s")
    body = body_of(random, (2, 1, 3, 0, 0))
    message = Message(kind, "s", 300, scalars_of(kind, from_hub), body)
    usual = [forms[0] for forms in encodings(message)]
    headers = [
        [*usual[:at], form, *usual[at + 1 :]] for at, forms in enumerate(encodings(message)) for form in forms
    ]
    headers += [[*usual[:2], b"\xa1t", *usual[3:]]]  # another session
    bodies = [body[:at] + bytes([body[at] ^ 1]) + body[at + 1 :] for at in range(16)]
    bodies += [
        body[:-1],
        body + b"x",
        body[:15],
        b"",
        body_of(random, (2, 1, 3, 2, 0)),
        body_of(random, (0, 0, 0, 0, 0)),
    ]
    different = [(b"".join(header), body) for header in headers] + [
        (b"".join(usual), body) for body in bodies
    ]
    if from_hub:
        paced = Message(Kind.AGENT_STEP, "s", 300, (1.0, 0.5, 0.25), body)
        different.append((encode(paced, FROM_HUB)[0], body))
        observed = Message(Kind.OBSERVED_STEP, "s", 300, (1, 2, 0.5, 0.5, False), 2 * body)
        header, two_bodies = encode(observed, FROM_HUB)
        different.append((header, two_bodies))
    for another in different:
        for frames in ((b"".join(usual), body), another):
            data = plain.encoded(random, frames)
            expected = events(plain.receiver, data)
            assert events(learned.receiver, data) == expected
            assert expected


@pytest.mark.proof
def test_what_a_stream_has_learned_changes_nothing() -> None:
    for seed in range(size(200, 50_000)):
        try:
            converse(seed)
        except Exception as error:
            raise AssertionError(f"conversation {seed}: {error}") from error
