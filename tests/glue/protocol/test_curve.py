"""CURVE without sockets: who gets in, what is refused, and what was recorded opens nothing."""

from __future__ import annotations

import struct
from collections.abc import Callable

import pytest

pytest.importorskip("nacl", reason="needs PyNaCl: pip install 'glue-rl[keys]'")

from glue.errors import RemoteProtocolError
from glue.protocol.curve import CurveServer, public_key
from glue.protocol.zmtp import CURVE_GREETING, DEALER, GREETING, ROUTER, Decoder, HandshakeRefused, encode
from tests.curve_client import GREETING as CLIENT_GREETING
from tests.curve_client import METADATA, CurveClient, Pair, command
from tests.glue.protocol.test_zmtp import events

MAX_FRAME = 100_000
SERVER, CAROL, STRANGER = Pair.new(), Pair.new(), Pair.new()


def server(*known: bytes) -> CurveServer:
    return CurveServer(SERVER.secret, (known or (CAROL.public,)).__contains__)


def greeted(mechanism: CurveServer | None = None) -> Decoder:
    """A decoder that has received a client's greeting."""
    decoder = Decoder(ROUTER, MAX_FRAME, mechanism or server())
    assert events(decoder, CLIENT_GREETING) == []
    return decoder


def said(decoder: Decoder, data: bytes) -> bytes:
    """The body of the one command that comes of `data`."""
    [answer] = events(decoder, data)
    assert isinstance(answer, bytes)
    assert answer[0] == 4
    assert answer[1] == len(answer) - 2
    return answer[2:]


def welcomed(decoder: Decoder, client: CurveClient) -> None:
    client.welcome(said(decoder, command(client.hello())))


def connected(mechanism: CurveServer | None = None) -> tuple[Decoder, CurveClient]:
    """Both ends of a connection, the handshake complete."""
    decoder, client = greeted(mechanism), CurveClient(CAROL, SERVER.public)
    welcomed(decoder, client)
    assert client.ready(said(decoder, command(client.initiate()))) == METADATA.replace(b"DEALER", b"ROUTER")
    assert decoder.ready
    return decoder, client


def test_a_public_key_belongs_to_its_secret_one() -> None:
    assert public_key(SERVER.secret) == SERVER.public


def test_the_greeting_of_the_server_says_that_it_is_one() -> None:
    assert CLIENT_GREETING[:32] + b"\x01" + bytes(31) == CURVE_GREETING


def test_messages_go_both_ways_with_their_flags_encrypted() -> None:
    mechanism = server()
    decoder, client = connected(mechanism)
    assert mechanism.client == CAROL.public
    large = bytes(MAX_FRAME)
    assert events(decoder, client.message(b"header", 1) + client.message(large)) == [[b"header", large]]
    first, second = mechanism.encode([b"header"]), mechanism.encode([b"x", large])
    assert client.read(first) == (0, b"header")
    assert client.read(second[: 2 + second[1]]) == (1, b"x")
    assert client.read(second[2 + second[1] :]) == (0, large)
    for data in (first, second):
        assert b"header" not in data
        assert data[0] == 0, "neither flag of ZMTP is set outside of the box"
    assert first[2:10] == b"\x07MESSAGE"


def test_bytes_that_come_one_by_one_are_understood() -> None:
    decoder, client = Decoder(ROUTER, MAX_FRAME, server()), CurveClient(CAROL, SERVER.public)

    def one_by_one(data: bytes) -> list[list[bytes] | bytes]:
        return [event for at in range(len(data)) for event in events(decoder, data[at : at + 1])]

    assert one_by_one(CLIENT_GREETING) == []
    [welcome] = one_by_one(command(client.hello()))
    assert isinstance(welcome, bytes)
    client.welcome(welcome[2:])
    assert len(one_by_one(command(client.initiate()))) == 1
    assert one_by_one(client.message(bytes(300), 1) + client.message(b"")) == [[bytes(300), b""]]


def test_a_ping_is_answered_encrypted() -> None:
    decoder, client = connected()
    [pong] = events(decoder, client.message(b"\x04PING\x00\x10abc", 2))
    assert isinstance(pong, bytes)
    assert client.read(pong) == (2, b"\x04PONGabc")
    assert events(decoder, client.message(b"\x03SUB", 2) + client.message(b"x")) == [[b"x"]]


def test_nothing_in_plain_text_is_read_quickly() -> None:
    decoder, _ = connected()
    assert not decoder.between_messages, "a step in plain text would be taken for one of the peer's"


def test_an_unknown_key_is_told_400_and_refused() -> None:
    decoder, client = greeted(), CurveClient(STRANGER, SERVER.public)
    welcomed(decoder, client)
    with pytest.raises(HandshakeRefused, match="key is not allowed") as refused:
        events(decoder, command(client.initiate()))
    assert refused.value.farewell == b"\x04\x0a\x05ERROR\x03400"
    assert not decoder.ready


def test_another_public_key_of_the_server_is_refused() -> None:
    with pytest.raises(RemoteProtocolError, match="another public key for the one of this hub"):
        events(greeted(), command(CurveClient(CAROL, STRANGER.public).hello()))


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
    # The key is known, but for the one who claims another's: what is refused is the rest.
    own = STRANGER if bent is BENT["another's C"] else CAROL
    decoder, client = greeted(), CurveClient(own, SERVER.public)
    welcomed(decoder, client)
    with pytest.raises(RemoteProtocolError):
        events(decoder, command(bent(client)))
    assert not decoder.ready


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
    said(second, hello)  # a HELLO proves nothing, and its answer says nothing to who repeats it
    with pytest.raises(RemoteProtocolError, match="does not fit together"):
        events(second, initiate)
    with pytest.raises(RemoteProtocolError, match="HELLO"):
        events(third, initiate)
    assert not second.ready
    assert not third.ready


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
    decoder, client = connected()
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
    decoder, _ = connected()
    with pytest.raises(RemoteProtocolError, match=why):
        events(decoder, said)


@pytest.mark.parametrize("flags", [3, 4, 255])
def test_flags_in_the_box_are_checked(flags: int) -> None:
    decoder, client = connected()
    with pytest.raises(RemoteProtocolError, match=f"flags {flags} in it"):
        events(decoder, client.message(b"x", flags))


def test_a_message_changed_on_its_way_is_refused() -> None:
    for at in range(2, 40):
        decoder, client = connected()
        frame = bytearray(client.message(b"15 bytes are 40"[:7]))
        frame[at] ^= 1
        with pytest.raises(RemoteProtocolError):
            events(decoder, bytes(frame))


def test_each_mechanism_refuses_the_other_clearly() -> None:
    with pytest.raises(RemoteProtocolError, match="b'NULL'; only CURVE is supported here"):
        events(Decoder(ROUTER, MAX_FRAME, server()), GREETING)
    with pytest.raises(RemoteProtocolError, match="b'CURVE'; only NULL is supported here"):
        events(Decoder(DEALER, MAX_FRAME), CURVE_GREETING)
    with pytest.raises(RemoteProtocolError, match="wants to be the server"):
        events(Decoder(ROUTER, MAX_FRAME, server()), CURVE_GREETING)


def test_a_client_that_gives_up_is_heard() -> None:
    with pytest.raises(RemoteProtocolError, match="ended the handshake: b'500'"):
        events(greeted(), b"\x04\x0a\x05ERROR\x03500")
