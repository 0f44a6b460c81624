"""Scenes of what comes over a connection beside calls and replies, as any client meets it."""

from __future__ import annotations

from typing import Final

from glue.protocol import zmtp
from glue.protocol.messages import Kind, Message
from glue.protocol.wire import FROM_HUB, encode
from glue.testing.conform.hub.comparing import described
from glue.testing.conform.hub.desk import LULL, Desk
from glue.testing.conform.hub.rules import EVERYONE, Broken, NotJudged, Rules, Tier
from glue.testing.conform.hub.wire import Gone
from glue.testing.conform.scenes import forms

__all__ = ["RULES"]

RULES: Final = Rules()

_LOOKS: Final = 50


@RULES.add("heartbeats", Tier.PLAYS, "greeting", "HEARTBEATs are ignored, whenever they come", EVERYONE)
def heartbeats(desk: Desk) -> None:
    beat = Message(Kind.HEARTBEAT, "", 0)
    for _ in range(desk.exchanges()):
        exchange = desk.prepare()
        desk.send_frames(encode(beat, FROM_HUB))
        desk.send_frames(encode(beat._replace(session=desk.session), FROM_HUB))
        desk.send_frames(exchange.frames)
        desk.take(exchange.expected)
        desk.send_frames(encode(beat, FROM_HUB))


@RULES.add(
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


@RULES.add(
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


@RULES.add(
    "ping",
    Tier.COMPLETE,
    "appendix-zeromq-without-libzmq",
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


@RULES.add(
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
        raise Broken(expected, described(got), frames)
    desk.cut()
    desk.reconnect()
    desk.exchange()


@RULES.add("idle", Tier.COMPLETE, "transport", "waiting costs nothing: it sleeps", EVERYONE)
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


@RULES.add(
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


@RULES.add(
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
            raise Broken(f"no answer to {name}", described(got), frames or ())
        if got is not None:
            desk.cut()  # It reported an error, or said GOODBYE.
        _orderly(desk, f"after {name}")
        desk.abandon()


def _orderly(desk: Desk, when: str) -> None:
    """Expect that the client did not crash; have one that goes on, be it another."""
    code = desk.client.wait(LULL) if desk.connected else desk.returns()
    if code is not None and code < 0:
        raise Broken(f"a client that goes on or reports an error {when}", f"its end by signal {-code}")
