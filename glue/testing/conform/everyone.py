"""Scenes of what agents, environments and experiments have in common: connections and greetings."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from glue.protocol import zmtp
from glue.protocol.messages import PROTOCOL_VERSION, ErrorCode, Kind, Message
from glue.protocol.wire import FROM_HUB, TO_HUB, encode
from glue.testing.conform import forms
from glue.testing.conform.desk import LULL, Desk, told
from glue.testing.conform.rules import EVERYONE, Broken, NotJudged, Rules, Tier
from glue.testing.conform.wire import Gone

__all__ = ["FIRST", "LAST"]

FIRST: Final = Rules()
"""To be judged first: without them, nothing else can be."""

LAST: Final = Rules()

_LOOKS: Final = 50

_ZMTP: Final = "appendix-zeromq-without-libzmq"


@FIRST.add(
    "handshake",
    Tier.PLAYS,
    _ZMTP,
    "ZMTP's handshake, as a DEALER; no message before the hub's READY",
    EVERYONE,
)
def handshake(desk: Desk) -> None:
    desk.drop()
    desk.start()
    desk.connect(hold=LULL)


@FIRST.add(
    "hello",
    Tier.PLAYS,
    "greeting",
    "HELLO comes first, with its role, 16 bytes of instance, and once",
    EVERYONE,
)
def hello(desk: Desk) -> None:
    desk.drop()
    desk.start()
    greeted = desk.connect()
    versions, role, instance, name, codec, _ = greeted.scalars
    frames = encode(greeted, TO_HUB)
    if not isinstance(versions, tuple) or PROTOCOL_VERSION not in versions:
        raise Broken(f"HELLO with the version {PROTOCOL_VERSION}", told(greeted), frames)
    if role != desk.role:
        raise Broken(f"HELLO with the role {desk.role!s}", told(greeted), frames)
    if not isinstance(instance, bytes) or len(instance) != 16 or len(set(instance)) < 3:
        raise Broken("HELLO with an instance of 16 random bytes", told(greeted), frames)
    if not name or not codec:
        raise Broken("HELLO with a name and a codec", told(greeted), frames)
    desk.nothing("after HELLO, until it is answered")
    desk.welcome(resumed=False)
    desk.begin()
    desk.exchange()


@FIRST.add(
    "restart", Tier.PLAYS, "greeting", "a program that is started again has another instance", EVERYONE
)
def restart(desk: Desk) -> None:
    desk.ready()
    before = desk.instance
    desk.drop()
    desk.ready()
    if desk.instance == before:
        raise Broken("another instance", f"that of the program before it, {before.hex()}")


@LAST.add("heartbeats", Tier.PLAYS, "greeting", "HEARTBEATs are ignored, whenever they come", EVERYONE)
def heartbeats(desk: Desk) -> None:
    beat = Message(Kind.HEARTBEAT, "", 0)
    for _ in range(desk.exchanges()):
        exchange = desk.prepare()
        desk.send_frames(encode(beat, FROM_HUB))
        desk.send_frames(encode(beat._replace(session=desk.session), FROM_HUB))
        desk.send_frames(exchange.frames)
        desk.take(exchange.expected)
        desk.send_frames(encode(beat, FROM_HUB))


@LAST.add(
    "instance",
    Tier.SURVIVES,
    "greeting",
    "the instance is the same over each new connection",
    EVERYONE,
    needs=("silent-until-welcomed",),
)
def instance(desk: Desk) -> None:
    before = desk.instance
    for _ in range(2):
        desk.cut()
        desk.reconnect()
        if desk.instance != before:
            raise Broken(f"the instance {before.hex()} again", desk.instance.hex())
    desk.exchange()


@LAST.add(
    "answer-lost",
    Tier.SURVIVES,
    "breaks-replacements-and-void-episodes",
    "an answer, or a request, that is lost with its connection comes again: at every step of an episode",
    EVERYONE,
    needs=("silent-until-welcomed",),
)
def answer_lost(desk: Desk) -> None:
    for number in range(desk.exchanges()):
        exchange = desk.prepare()
        desk.send_frames(exchange.frames)
        frames = desk.take(exchange.expected)
        desk.cut(reset=number % 2 == 1)
        desk.connect()
        desk.welcome()
        desk.repeat(exchange, frames)


@LAST.add(
    "call-lost",
    Tier.SURVIVES,
    "breaks-replacements-and-void-episodes",
    "a message of the hub that is torn by the end of its connection counts for nothing: at every step",
    EVERYONE,
    needs=(
        "silent-until-welcomed",
        "answer-lost",
    ),
)
def call_lost(desk: Desk) -> None:
    for number in range(desk.exchanges()):
        exchange = desk.prepare()
        data = zmtp.encode(exchange.frames)
        desk.send_bytes(data[: 1 + number * len(data) // desk.exchanges()])
        desk.cut()
        desk.reconnect()
        desk.send_frames(exchange.frames)
        desk.take(exchange.expected)


@LAST.add(
    "handshakes-lost",
    Tier.SURVIVES,
    "transport",
    "a connection may end at any point of its handshake and greeting",
    EVERYONE,
    needs=("silent-until-welcomed",),
)
def handshakes_lost(desk: Desk) -> None:
    steps: list[Callable[[], None]] = [
        lambda: None,
        lambda: desk.send_bytes(zmtp.GREETING[:10]),
        lambda: desk.send_bytes(zmtp.GREETING),
        lambda: desk.wire.greet(desk.wait),
    ]
    for step in steps:
        desk.cut()
        desk.adopt(desk.accept())
        step()
    desk.cut()
    desk.connect()  # And once after HELLO, without a WELCOME.
    desk.cut()
    desk.reconnect()
    desk.exchange()


@LAST.add(
    "absent",
    Tier.SURVIVES,
    "transport",
    "a hub that is away for a while is waited for",
    EVERYONE,
    needs=("silent-until-welcomed",),
)
def absent(desk: Desk) -> None:
    desk.listener.close()
    try:
        desk.cut()
        code = desk.client.wait(2 * LULL)
    finally:
        desk.listener.open()
    if code is not None:
        raise Broken("a client that waits for the hub", f"its end, with exit code {code}")
    desk.reconnect()
    desk.exchange()


@LAST.add(
    "unknown-peer",
    Tier.SURVIVES,
    "greeting",
    "the error unknown-peer is answered with HELLO, over the same connection",
    EVERYONE,
    needs=("silent-until-welcomed",),
)
def unknown_peer(desk: Desk) -> None:
    before = desk.hellos
    desk.send(Kind.ERROR, ErrorCode.UNKNOWN_PEER, "say HELLO", seq=0)
    desk.greeted_again()
    desk.resume()
    desk.exchange()
    if desk.hellos != before + 1:
        raise Broken("one HELLO", f"{desk.hellos - before}")


@LAST.add(
    "torn",
    Tier.SURVIVES,
    "appendix-zeromq-without-libzmq",
    "bytes may come one by one, and many messages at once",
    EVERYONE,
    needs=("heartbeats",),
)
def torn(desk: Desk) -> None:
    beat = zmtp.encode(encode(Message(Kind.HEARTBEAT, "", 0), FROM_HUB))
    for _ in range(2):
        exchange = desk.prepare()
        for byte in zmtp.encode(exchange.frames):
            desk.send_bytes(bytes([byte]))
        desk.take(exchange.expected)
    for _ in range(3):
        exchange = desk.prepare()
        desk.send_bytes(beat * 200 + zmtp.encode(exchange.frames))
        desk.take(exchange.expected)


@LAST.add(
    "crossing",
    Tier.SURVIVES,
    "transport",
    "HEARTBEATs that come while it sends its frames hold nothing up",
    EVERYONE,
    needs=("heartbeats",),
)
def crossing(desk: Desk) -> None:
    beat = zmtp.encode(encode(Message(Kind.HEARTBEAT, "", 0), FROM_HUB))
    for _ in range(desk.exchanges()):
        exchange = desk.prepare()
        desk.send_bytes(zmtp.encode(exchange.frames) + 3 * beat)
        desk.take(exchange.expected)


@LAST.add(
    "ping",
    Tier.COMPLETE,
    _ZMTP,
    "PING is answered with PONG and its context, other commands are ignored",
    EVERYONE,
)
def ping(desk: Desk) -> None:
    for context in (b"", b"sixteen bytes 16"):
        desk.send_bytes(_command(b"PING", b"\x01\x2c" + context))
        pong = _command(b"PONG", context)
        if not desk.kept(lambda pong=pong: desk.wire.hears(pong, desk.wait)):  # type: ignore[misc]
            raise Broken(
                f"PONG with the context {context!r}, {pong.hex(' ')}", f"nothing like it in {desk.wait:g} s"
            )
    desk.send_bytes(_command(b"SOMETHING", b"new") + _command(b"PONG", b""))
    desk.exchange()


def _command(name: bytes, data: bytes) -> bytes:
    return bytes([4, 1 + len(name) + len(data), len(name)]) + name + data


@LAST.add(
    "silence",
    Tier.COMPLETE,
    "greeting",
    "a peer that hears nothing for a heartbeat sends HEARTBEAT",
    EVERYONE,
    needs=("silent-until-welcomed",),
)
def silence(desk: Desk) -> None:
    desk.cut()
    desk.connect()
    desk.welcome(heartbeat=0.1)
    desk.resume()
    frames = desk.kept(lambda: desk.wire.receive(desk.wait))
    expected = f"HEARTBEAT, since 0.1 s of heartbeat were agreed, in {desk.wait:g} s"
    if frames is None:
        raise Broken(expected, "nothing")
    got = desk.decoded(frames, expected)
    if (got.kind, got.session) != (Kind.HEARTBEAT, desk.session):
        raise Broken(expected, told(got), frames)
    desk.cut()
    desk.reconnect()
    desk.exchange()


@LAST.add("idle", Tier.COMPLETE, "transport", "waiting costs nothing: it sleeps", EVERYONE)
def idle(desk: Desk) -> None:
    # Not its CPU time: on a busy machine a client that never sleeps may get little of it.
    awake = []
    for _ in range(_LOOKS):
        desk.nothing("without a call", 0.02)
        awake.append(desk.client.awake())
    if None in awake:
        raise NotJudged("whether the client sleeps cannot be seen here")
    if sum(map(bool, awake)) > _LOOKS / 2:
        raise Broken(
            "a client that sleeps while it waits",
            f"one that was awake at {sum(map(bool, awake))} of {_LOOKS} looks",
        )


@LAST.add(
    "huge-frame",
    Tier.COMPLETE,
    "limits-and-defaults",
    "a frame that is far too long ends the connection, before there is room for it",
    EVERYONE,
)
def huge_frame(desk: Desk) -> None:
    for size in (2**62, 2**40):
        desk.send_bytes(bytes([2]) + size.to_bytes(8, "big") + bytes(100))
        if not desk.wire.ends(desk.wait):
            raise Broken(f"the end of the connection after a frame of {size} bytes was announced", "nothing")
        desk.cut()
        # libzmq ends a socket for good after that: whether the client comes back is its own affair.
        code = desk.client.wait(LULL)
        if code is not None and code < 0:
            raise Broken(f"an orderly end after a frame of {size} bytes", f"one by signal {-code}")
        desk.abandon()
        desk.ready()


@LAST.add(
    "malformed",
    Tier.COMPLETE,
    "what-a-peer-must-should-and-may-do",
    "what is no message is not taken for one, and does not crash it",
    EVERYONE,
)
def malformed(desk: Desk) -> None:
    for name, change in forms.SPOILED.items():
        desk.ready()
        for _ in range(2):
            desk.exchange()
        exchange = desk.prepare()
        desk.send_frames(change(exchange.frames))
        try:
            frames = desk.wire.receive(LULL)
            while frames is not None and desk.decoded(frames).kind is Kind.HEARTBEAT:
                frames = desk.wire.receive(LULL)
        except Gone:
            frames = None
            desk.cut()
        got = None if frames is None else desk.decoded(frames)
        if got is not None and got.kind is exchange.expected.kind:
            raise Broken(f"no answer to {name}", told(got), frames or ())
        if got is not None:
            desk.cut()  # It reported an error, or said GOODBYE.
        _orderly(desk, f"after {name}")
        desk.abandon()


def _orderly(desk: Desk, when: str) -> None:
    """Expect that the client did not crash; have one that goes on, be it another."""
    code = desk.client.wait(LULL) if desk.connected else desk.returns()
    if code is not None and code < 0:
        raise Broken(f"a client that goes on or reports an error {when}", f"its end by signal {-code}")


@LAST.add(
    "goodbye", Tier.PLAYS, "greeting", "GOODBYE ends it, without another word; its reason is shown", EVERYONE
)
def goodbye(desk: Desk) -> None:
    desk.exchange()
    reason = "the hub closes for good"
    desk.send(Kind.GOODBYE, reason)
    try:
        frames = desk.wire.receive(desk.wait)
    except Gone:
        frames = None
    if frames is not None:
        raise Broken("nothing after GOODBYE", "a message", frames)
    desk.cut()
    code = _ended(desk, "GOODBYE", reason)
    if code:
        raise Broken("exit code 0 after GOODBYE", str(code))


@LAST.add(
    "refusal",
    Tier.PLAYS,
    "greeting",
    "REFUSE ends it; its text is shown, and the exit code is not 0",
    EVERYONE,
)
def refusal(desk: Desk) -> None:
    desk.drop()
    desk.start()
    greeted = desk.connect()
    reason = "this hub has no room for mirrors"
    desk.send(Kind.REFUSE, ErrorCode.FULL, reason, seq=greeted.seq)
    desk.wire.ends(desk.wait)
    desk.cut()
    if _ended(desk, "REFUSE", reason) == 0:
        raise Broken("an exit code other than 0 after REFUSE", "0")


def _ended(desk: Desk, kind: str, reason: str) -> int:
    code = desk.client.wait(desk.wait)
    if code is None:
        raise Broken(f"the client's end after {kind}", f"none in {desk.wait:g} s")
    if code < 0:
        raise Broken(f"the client's end after {kind}", f"its end by signal {-code}")
    if reason not in desk.output():
        raise Broken(f"that it prints {reason!r}", f"{desk.output()[-300:]!r}")
    return code
