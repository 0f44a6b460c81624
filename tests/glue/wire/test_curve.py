"""Both ends of CURVE without sockets, and each against libzmq: admission and refusals."""

from __future__ import annotations

import socket
import struct
from collections.abc import Callable
from contextlib import suppress

import pytest
import zmq

pytest.importorskip("nacl", reason="needs PyNaCl: pip install 'glue-rl[keys]'")

from glue.errors import RemoteProtocolError
from glue.keys.certificates import encode as key_text
from glue.wire import curve
from glue.wire.curve import CurveServer, public_key
from glue.wire.zmtp import (
    CURVE_CLIENT_GREETING,
    CURVE_GREETING,
    DEALER,
    GREETING,
    ROUTER,
    Decoder,
    HandshakeEnded,
    HandshakeRefused,
    OtherMechanism,
    encode,
    head,
)
from tests.glue.wire.test_zmtp import events
from tests.scripted.curve import GREETING as CLIENT_GREETING
from tests.scripted.curve import METADATA, CurveClient, Pair, command

MAX_FRAME = 100_000
SERVER, CAROL, STRANGER = Pair.new(), Pair.new(), Pair.new()


def server(*known: bytes) -> CurveServer:
    return CurveServer(SERVER.secret, (known or (CAROL.public,)).__contains__)


def greeted(mechanism: CurveServer | None = None) -> Decoder:
    """Return a decoder that has received a client's greeting."""
    decoder = Decoder(ROUTER, MAX_FRAME, mechanism or server())
    assert events(decoder, CLIENT_GREETING) == []
    return decoder


def said(decoder: Decoder, data: bytes) -> bytes:
    """Return the body of the one command that answers `data`."""
    [answer] = events(decoder, data)
    assert isinstance(answer, bytes)
    assert answer[0] == 4
    assert answer[1] == len(answer) - 2
    return answer[2:]


def welcomed(decoder: Decoder, client: CurveClient) -> None:
    client.welcome(said(decoder, command(client.hello())))


def connected() -> tuple[CurveServer, Decoder, CurveClient]:
    """Return both ends of a connection whose handshake is complete: the hub's with its decoder."""
    mechanism = server()
    decoder, client = greeted(mechanism), CurveClient(CAROL, SERVER.public)
    welcomed(decoder, client)
    assert client.ready(said(decoder, command(client.initiate()))) == METADATA.replace(b"DEALER", b"ROUTER")
    assert decoder.ready
    return mechanism, decoder, client


def test_a_public_key_belongs_to_its_secret_one() -> None:
    assert public_key(SERVER.secret) == SERVER.public


def test_the_greeting_of_the_server_says_that_it_is_one() -> None:
    assert CLIENT_GREETING[:32] + b"\x01" + bytes(31) == CURVE_GREETING
    assert CLIENT_GREETING == CURVE_CLIENT_GREETING


@pytest.mark.parametrize("header", [0, 1, 30, 222])
@pytest.mark.parametrize("body", [0, 1, 222, 223, 255, 256, 3000])
def test_a_message_of_two_frames_is_opened_as_a_whole(header: int, body: int) -> None:
    mechanism, _, client = connected()
    frames = [bytes(range(header)), bytes(i % 251 for i in range(body))]
    for _ in range(2):
        message = mechanism.open_message(client.message(frames[0], 1) + client.message(frames[1]))
        assert message == tuple(frames)


@pytest.mark.parametrize("header", [0, 1, 30, 222])
@pytest.mark.parametrize("body", [0, 1, 222, 223, 255, 256, 3584, 4000])
def test_a_message_of_two_frames_is_sealed_as_a_whole(header: int, body: int) -> None:
    mechanism, _, client = connected()
    for fill in range(3):
        frames = [bytes([fill]) * header, bytes([fill]) * body]
        sealed = bytes(mechanism.seal_message(*frames))
        first, rest = sealed[2 : 2 + sealed[1]], sealed[2 + sealed[1] :]
        last = rest[9:] if rest[0] else rest[2:]
        assert [client.read(first), client.read(last)] == [(1, frames[0]), (0, frames[1])]
        assert rest[: -len(last)] == head(0, len(last))
        assert [frame[8:16] for frame in (first, last)] == [
            struct.pack(">Q", number) for number in (2 * fill + 2, 2 * fill + 3)
        ], "numbers follow that of READY, and none is used twice"


def anything_else(client: CurveClient) -> dict[str, bytes]:
    """Return data that a client may send, and that is not one message of two frames."""
    first, last = client.message(b"header", 1), client.message(b"body")
    long = b"\x02" + struct.pack(">Q", first[1]) + first[2:]
    return {
        "one frame": first,
        "three frames": first + last + client.message(b"more"),
        "a part": (first + last)[:-1],
        "two messages": client.message(b"") + client.message(b"body"),
        "a frame that more follow": client.message(b"header", 1) + client.message(b"body", 1),
        "a command": client.message(b"header", 1) + client.message(b"\x04PING", 2),
        "a long first frame": long + last,
        "too large": client.message(b"header", 1) + client.message(bytes(MAX_FRAME)),
    }


@pytest.mark.parametrize("what", anything_else(connected()[2]))
def test_anything_else_is_left_to_the_decoder(what: str) -> None:
    mechanism, decoder, client = connected()
    data = anything_else(client)[what]
    received = mechanism._received
    assert mechanism.open_message(data) is None
    assert mechanism._received == received
    events(decoder, data)


def test_each_changed_bit_is_found_and_the_message_itself_can_still_be_read() -> None:
    mechanism, _, client = connected()
    data = client.message(b"header", 1) + client.message(b"body of a step")
    for at in range(8 * len(data)):
        changed = bytearray(data)
        changed[at // 8] ^= 1 << at % 8
        assert mechanism.open_message(bytes(changed)) is None, f"bit {at}"
    assert mechanism.open_message(data) == (b"header", b"body of a step")
    assert mechanism.open_message(data) is None, "a replay"


@pytest.mark.parametrize("order", ["a replayed first frame", "an older last frame"])
def test_frames_of_two_messages_are_not_one(order: str) -> None:
    mechanism, decoder, client = connected()
    earlier, later = ([client.message(b"header", 1), client.message(b"body")] for _ in range(2))
    if order == "a replayed first frame":
        assert mechanism.open_message(b"".join(earlier)) is not None
        mixed = earlier[0] + later[1]
    else:
        mixed = later[0] + earlier[1]
    assert mechanism.open_message(mixed) is None
    with pytest.raises(RemoteProtocolError, match="nonce"):
        events(decoder, mixed)


def test_messages_go_both_ways_with_their_flags_encrypted() -> None:
    mechanism, decoder, client = connected()
    assert mechanism.client == CAROL.public
    large = bytes(MAX_FRAME)
    assert events(decoder, client.message(b"header", 1) + client.message(large)) == [[b"header", large]]
    first, second = bytes(mechanism.encode([b"header"])), bytes(mechanism.encode([b"x", large]))
    assert client.read(first[2:]) == (0, b"header")
    assert client.read(second[2 : 2 + second[1]]) == (1, b"x")
    assert client.read(second[2 + second[1] + 9 :]) == (0, large)
    for data in (first, second):
        assert b"header" not in data
        assert data[0] == 0, "neither flag of ZMTP is set outside of the box"
    assert first[2:10] == b"\x07MESSAGE"


def test_a_ping_is_answered_encrypted() -> None:
    _, decoder, client = connected()
    [pong] = events(decoder, client.message(b"\x04PING\x00\x10abc", 2))
    assert isinstance(pong, bytes)
    assert client.read(pong[2:]) == (2, b"\x04PONGabc")
    assert events(decoder, client.message(b"\x03SUB", 2) + client.message(b"x")) == [[b"x"]]


def test_nothing_in_plain_text_is_read_quickly() -> None:
    _, decoder, _ = connected()
    decoder.receive_data(b"\0\1x")
    assert not decoder.take_back(), "a step in plain text would be taken for one of the peer's"


def test_an_unknown_key_is_told_400_and_refused() -> None:
    decoder, client = greeted(), CurveClient(STRANGER, SERVER.public)
    welcomed(decoder, client)
    with pytest.raises(HandshakeRefused, match="key is not allowed") as refused:
        events(decoder, command(client.initiate()))
    assert refused.value.farewell == b"\x04\x0a\x05ERROR\x03400"
    assert not decoder.ready


Bent = Callable[[CurveClient], bytes]

BENT: dict[str, Bent] = {
    "another C' in the vouch": lambda client: client.initiate(vouched=STRANGER.public + SERVER.public),
    "another S in the vouch": lambda client: client.initiate(vouched=client.short.public + STRANGER.public),
    "half a vouch": lambda client: client.initiate(vouched=client.short.public),
    "another's C": lambda client: client.initiate(claimed=CAROL.public),
    "a cookie of its own": lambda client: client.initiate(cookie=bytes(96)),
    "too short": lambda client: client.initiate()[:-30],
    "no INITIATE": lambda client: client.hello(),
    "an old nonce": lambda client: (setattr(client, "number", 0), client.initiate())[1],  # type: ignore[func-returns-value]
    "another socket": lambda client: client.initiate(METADATA.replace(b"DEALER", b"SUB".ljust(6))),
    "no socket": lambda client: client.initiate(b""),
}


@pytest.mark.parametrize("bent", BENT.values(), ids=BENT)
def test_an_initiate_is_checked_whoever_made_it(bent: Bent) -> None:
    # The key is known, except for "another's C": the rest of the INITIATE is refused.
    own = STRANGER if bent is BENT["another's C"] else CAROL
    decoder, client = greeted(), CurveClient(own, SERVER.public)
    welcomed(decoder, client)
    with pytest.raises(RemoteProtocolError):
        events(decoder, command(bent(client)))
    assert not decoder.ready


def test_an_encrypted_frame_has_a_long_head_from_256_bytes_on() -> None:
    mechanism, decoder, client = connected()
    for size in (222, 223):
        assert events(decoder, client.message(bytes(size))) == [[bytes(size)]]
    assert [mechanism.encode([bytes(size)])[:1] for size in (222, 223)] == [b"\0", b"\2"]


def _with_bit(data: bytes, at: int, bit: int) -> bytes:
    return data[:at] + bytes((data[at] | bit,)) + data[at + 1 :]


@pytest.mark.parametrize(
    "body",
    [
        CurveClient(CAROL, SERVER.public).hello(version=b"\x02\x00"),
        CurveClient(CAROL, SERVER.public).hello(zeros=bytes(63) + b"\1"),
        CurveClient(CAROL, SERVER.public, number=-1).hello(),
        CurveClient(CAROL, SERVER.public).hello() + b"\0",
        CurveClient(CAROL, SERVER.public, Pair(bytes(32), CAROL.secret)).hello(),
        _with_bit(CurveClient(CAROL, SERVER.public).hello(), 80 + 31, 0x80),
        b"\x05READY" + METADATA,
        b"",
    ],
    ids=["version", "box", "nonce 0", "too long", "low order", "ignored bit", "NULL's READY", "empty"],
)
def test_a_hello_is_checked(body: bytes) -> None:
    with pytest.raises(RemoteProtocolError) as raised:
        events(greeted(), command(body))
    assert str(raised.value).isprintable()


def test_what_was_recorded_of_one_connection_opens_no_other() -> None:
    first, second, third = greeted(), greeted(), greeted()
    client = CurveClient(CAROL, SERVER.public)
    hello = command(client.hello())
    client.welcome(said(first, hello))
    initiate = command(client.initiate())
    said(first, initiate)
    assert first.ready
    said(second, hello)  # a HELLO proves nothing, and its answer is useless to a peer that repeats it
    with pytest.raises(RemoteProtocolError, match="inconsistent"):
        events(second, initiate)
    with pytest.raises(RemoteProtocolError, match="HELLO"):
        events(third, initiate)
    assert not second.ready
    assert not third.ready


@pytest.mark.parametrize(("changed", "size"), [("hello", 202), ("initiate", 288)])
def test_a_handshake_that_is_changed_anywhere_admits_nobody(changed: str, size: int) -> None:
    for at in range(size):
        decoder, client = greeted(), CurveClient(CAROL, SERVER.public)
        sent = bytearray(command(client.hello()))
        if changed == "initiate":
            client.welcome(said(decoder, bytes(sent)))
            sent = bytearray(command(client.initiate()))
        assert len(sent) == size
        sent[at] ^= 1
        answered: list[object] = []
        with suppress(RemoteProtocolError):  # not with a greater size, which waits for more
            answered += events(decoder, bytes(sent))
        assert (answered, decoder.ready) == ([], False), at


def test_within_a_connection_neither_handshake_nor_message_can_be_repeated() -> None:
    for repeat in ("hello", "initiate", "message"):
        decoder, client = greeted(), CurveClient(CAROL, SERVER.public)
        sent = {"hello": command(client.hello())}
        client.welcome(said(decoder, sent["hello"]))
        if repeat != "hello":
            sent["initiate"] = command(client.initiate())
            said(decoder, sent["initiate"])
            sent["message"] = client.message(b"once")
            assert events(decoder, sent["message"]) == [[b"once"]]
        with pytest.raises(RemoteProtocolError):
            events(decoder, sent[repeat])


def test_nonces_may_leave_gaps_and_never_go_back() -> None:
    _, decoder, client = connected()
    late = client.message(b"late")
    client.number += 1000
    assert events(decoder, client.message(b"x")) == [[b"x"]]
    with pytest.raises(RemoteProtocolError, match="a replay"):
        events(decoder, late)


@pytest.mark.parametrize(
    ("said", "why"),
    [
        (encode([b"plain"]), "not encrypted"),
        (encode([bytes(100)]), "not encrypted"),
        (encode([b"first", b"second"]), "cannot have the flags 1"),
        (b"\x04\x07\x04PING\x00\x00", "cannot have the flags 4"),
        (b"\x04\x0a\x05ERROR\x03400", "cannot have the flags 4"),
        (b"\x02" + struct.pack(">Q", MAX_FRAME + 34), f"{MAX_FRAME + 33} are allowed"),
    ],
    ids=["short", "long", "two frames", "command", "error", "too large"],
)
def test_after_the_handshake_all_is_encrypted(said: bytes, why: str) -> None:
    _, decoder, _ = connected()
    with pytest.raises(RemoteProtocolError, match=why):
        events(decoder, said)


@pytest.mark.parametrize("flags", [3, 4, 255])
def test_flags_in_the_box_are_checked(flags: int) -> None:
    _, decoder, client = connected()
    with pytest.raises(RemoteProtocolError, match=f"flags {flags} in it"):
        events(decoder, client.message(b"x", flags))


def test_a_message_changed_on_its_way_is_refused() -> None:
    for at in range(2, 40):
        _, decoder, client = connected()
        frame = bytearray(client.message(b"15 bytes are 40"[:7]))
        frame[at] ^= 1
        with pytest.raises(RemoteProtocolError):
            events(decoder, bytes(frame))


def test_each_mechanism_refuses_the_other_clearly() -> None:
    with pytest.raises(RemoteProtocolError, match="b'NULL'; only CURVE is supported here"):
        events(Decoder(ROUTER, MAX_FRAME, server()), GREETING)
    with pytest.raises(RemoteProtocolError, match="b'CURVE'; only NULL is supported here"):
        events(Decoder(DEALER, MAX_FRAME), CURVE_GREETING)
    with pytest.raises(RemoteProtocolError, match="both sides are servers"):
        events(Decoder(ROUTER, MAX_FRAME, server()), CURVE_GREETING)


def test_a_client_that_gives_up_is_heard() -> None:
    with pytest.raises(HandshakeEnded):
        events(greeted(), b"\x04\x0a\x05ERROR\x03500")


# The client's end.


def client_of(own: Pair = CAROL, expected: bytes = SERVER.public) -> tuple[curve.CurveClient, Decoder]:
    """Return the client's end of a connection, and its decoder."""
    mechanism = curve.CurveClient(own.public, own.secret, expected)
    return mechanism, Decoder(DEALER, MAX_FRAME, mechanism)


def shake_hands(client: Decoder, hub: Decoder, piece: int = MAX_FRAME) -> None:
    """Pass bytes between both ends, a piece at a time, until neither sends any more."""
    pending = [(hub, CURVE_CLIENT_GREETING), (client, CURVE_GREETING)]
    while pending:
        receiver, data = pending.pop(0)
        sender = client if receiver is hub else hub
        for at in range(0, len(data), piece):
            for event in events(receiver, data[at : at + piece]):
                assert isinstance(event, bytes)
                pending.append((sender, event))


@pytest.mark.parametrize("piece", [1, 7, MAX_FRAME])
def test_both_ends_understand_each_other(piece: int) -> None:
    (ours, client), hub_end = client_of(), server()
    hub = Decoder(ROUTER, MAX_FRAME, hub_end)
    shake_hands(client, hub, piece)
    assert client.ready
    assert hub.ready
    assert hub_end.client == CAROL.public
    large = bytes(MAX_FRAME)
    for sender, receiver in ((ours, hub), (hub_end, client)):
        first, second = bytes(sender.encode([b"header", large])), bytes(sender.encode([b""]))
        assert b"header" not in first
        assert events(receiver, first + second) == [[b"header", large], [b""]]
        with pytest.raises(RemoteProtocolError, match="a replay"):
            events(receiver, first)


def test_no_two_connections_use_the_same_keys() -> None:
    hellos = {client_of()[0].begin() for _ in range(3)}
    assert len(hellos) == 3


def test_a_client_tells_its_unknown_key_from_a_wrong_key_of_the_hub() -> None:
    for own, expected, known in ((STRANGER, SERVER.public, True), (CAROL, STRANGER.public, False)):
        mechanism, client = client_of(own, expected)
        hub = greeted()
        [hello] = events(client, CURVE_GREETING)
        assert isinstance(hello, bytes)
        with pytest.raises(HandshakeRefused) as refused:
            events(hub, said_to(client, events(hub, hello)))
        with pytest.raises(HandshakeEnded):
            events(client, refused.value.farewell)
        assert mechanism.server_known is known
        assert not client.ready


def said_to(receiver: Decoder, answers: list[list[bytes] | bytes]) -> bytes:
    """Return a decoder's answers to those of the other end."""
    heard = b"".join(answer for answer in answers if isinstance(answer, bytes))
    return b"".join(event for event in events(receiver, heard) if isinstance(event, bytes))


def test_a_client_believes_no_changed_handshake() -> None:
    for changed in ("welcome", "ready"):
        for at in (0, 5, 10, 40, -1):
            (_, client), hub = client_of(), greeted()
            [hello] = events(client, CURVE_GREETING)
            [answer] = events(hub, bytes(hello))  # type: ignore[arg-type]
            if changed == "ready":
                [initiate] = events(client, bytes(answer))  # type: ignore[arg-type]
                [answer] = events(hub, bytes(initiate))  # type: ignore[arg-type]
            body = bytearray(answer[2:])  # type: ignore[arg-type]
            body[at] ^= 1
            with pytest.raises(RemoteProtocolError):
                events(client, command(bytes(body)))
            assert not client.ready


@pytest.mark.parametrize(
    "body", [b"\x05READY", b"\x07WELCOME" + bytes(159), b"\x07WELCOME" + bytes(161), b"x"], ids=str
)
def test_a_client_takes_only_a_welcome_for_its_hello(body: bytes) -> None:
    _, client = client_of()
    events(client, CURVE_GREETING)
    with pytest.raises(RemoteProtocolError):
        events(client, command(body))


def test_a_client_refuses_a_hub_in_plain_text() -> None:
    with pytest.raises(OtherMechanism):
        events(client_of()[1], GREETING)


def test_a_client_and_a_router_of_libzmq_understand_each_other() -> None:
    with zmq.Context() as context, context.socket(zmq.ROUTER) as router:
        router.setsockopt(zmq.RCVTIMEO, 20_000)
        router.curve_server = True
        router.curve_secretkey = key_text(SERVER.secret).encode()
        router.setsockopt(zmq.HEARTBEAT_IVL, 20)
        port = router.bind_to_random_port("tcp://127.0.0.1")
        mechanism, decoder = client_of()
        with socket.create_connection(("127.0.0.1", port), 20) as peer:

            def read() -> list[bytes] | None:
                """Return the next message, or None once the handshake is complete."""
                for event in events(decoder, peer.recv(65_536)):
                    if isinstance(event, list):
                        return event
                    peer.sendall(event)
                return None

            peer.sendall(CURVE_CLIENT_GREETING)
            while not decoder.ready:
                read()
            sent = [b"header", bytes(MAX_FRAME)]
            peer.sendall(mechanism.encode(sent))
            received = router.recv_multipart()
            assert received[1:] == sent
            router.send_multipart(received)
            while (answer := read()) is None:
                pass
            assert answer == sent
