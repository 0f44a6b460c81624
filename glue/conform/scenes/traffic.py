"""Scenes of all other traffic on a connection, for any client: heartbeats, commands, malformed messages."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from glue.conform.hub.comparing import described
from glue.conform.hub.connection import Gone
from glue.conform.hub.harness import MAX_BODY, Exchange, Harness
from glue.conform.hub.rules import EVERYONE, Broken, NotJudged, Requirement, Rules, Tier
from glue.conform.scenes import forms
from glue.doors import clock
from glue.wire import zmtp
from glue.wire.codec import FROM_HUB, decode, encode
from glue.wire.messages import PROTOCOL_VERSION, ErrorCode, Kind, Message

RULES: Final = Rules(EVERYONE)

_LOOKS: Final = 50
"""Number of times that the client's state is polled."""

_BEATS: Final = 5
_BEATS_WITHIN: Final = 1.5
"""Maximum time for the heartbeats, in seconds: generous at 0.1 s each, too short at the default of 1 s."""


@RULES.add(Tier.PLAYS, "greeting")
def heartbeats(kit: Harness) -> None:
    """HEARTBEATs are ignored at any time."""
    beat = Message(Kind.HEARTBEAT, "", 0)
    for _ in range(kit.exchanges()):
        exchange = kit.prepare()
        kit.send_frames(encode(beat, FROM_HUB))
        kit.send_frames(encode(beat._replace(session=kit.session), FROM_HUB))
        kit.run(exchange)
        kit.send_frames(encode(beat, FROM_HUB))


@RULES.add(Tier.SURVIVES, "appendix-zeromq-without-libzmq", needs=("heartbeats",))
def torn(kit: Harness) -> None:
    """Bytes may arrive one by one, and many messages at once."""
    beat = zmtp.encode(encode(Message(Kind.HEARTBEAT, "", 0), FROM_HUB))
    for _ in range(2):
        exchange = kit.prepare()
        for byte in zmtp.encode(exchange.frames):
            kit.send_bytes(bytes([byte]))
        kit.take(exchange.expected)
    for _ in range(3):
        exchange = kit.prepare()
        kit.send_bytes(beat * 200 + zmtp.encode(exchange.frames))
        kit.take(exchange.expected)


@RULES.add(Tier.SURVIVES, "transport", needs=("heartbeats",))
def crossing(kit: Harness) -> None:
    """HEARTBEATs that arrive while the client sends its frames do not block it."""
    beat = zmtp.encode(encode(Message(Kind.HEARTBEAT, "", 0), FROM_HUB))
    for _ in range(kit.exchanges()):
        exchange = kit.prepare()
        kit.send_bytes(zmtp.encode(exchange.frames) + 3 * beat)
        kit.take(exchange.expected)


@RULES.add(Tier.COMPLETE, "appendix-zeromq-without-libzmq")
def ping(kit: Harness) -> None:
    """PING is answered with PONG and its context, other commands are ignored."""
    for context in (b"", b"sixteen bytes 16"):
        kit.send_bytes(_command(b"PING", b"\x01\x2c" + context))
        pong = _command(b"PONG", context)
        if not kit.kept(lambda pong=pong: kit.connection.hears(pong, kit.wait)):  # type: ignore[misc]
            raise Broken(
                f"PONG with the context {context!r}, {pong.hex(' ')}", f"nothing like it in {kit.wait:g} s"
            )
    kit.send_bytes(_command(b"SOMETHING", b"new") + _command(b"PONG", b""))
    kit.exchange()


def _command(name: bytes, data: bytes) -> bytes:
    return bytes([4, 1 + len(name) + len(data), len(name)]) + name + data


@RULES.add(Tier.SURVIVES, "overview")
def other_sessions(kit: Harness) -> None:
    """Messages of other sessions change nothing in the client's own."""
    other = f"{kit.session}-2"
    exchange = kit.prepare()
    asked = decode(exchange.frames, FROM_HUB)
    welcome = (PROTOCOL_VERSION, False, 1.0, 5.0, MAX_BODY)
    for message in (
        asked,
        Message(Kind.WELCOME, other, 0, welcome),
        Message(Kind.ERROR, other, asked.seq, (ErrorCode.UNKNOWN_PEER, "say HELLO")),
        Message(Kind.ERROR, other, asked.seq, (ErrorCode.PEER_LOST, "the agent was lost")),
        Message(Kind.GOODBYE, other, 0, ("that session is over",)),
    ):
        kit.send_frames(encode(message._replace(session=other), FROM_HUB))
        # The client may report an error in the other session.
        while (frames := kit.kept(lambda: kit.heard(kit.quiet / 2))) is not None:
            got = kit.decoded(frames)
            if got.kind is not Kind.ERROR or got.session == kit.session:
                raise Broken(
                    f"nothing in answer to {message.kind.name} of session {other!r}", described(got), frames
                )
    kit.run(exchange)
    kit.exchange()


@RULES.add(Tier.PLAYS, "limits-and-defaults")
def session_names(kit: Harness) -> None:
    """The name of a session is UTF-8, of up to 255 characters."""
    for name in ("größer-als-π-走る", "🏃" * 255):
        kit.fresh(name)
        kit.exchange()
    kit.drop()


@RULES.add(Tier.SURVIVES, "greeting", level=Requirement.SHOULD, needs=("silent-until-welcomed",))
def hello_once(kit: Harness) -> None:
    """HELLO is said once over each connection, whether it is answered soon or late."""
    kit.cut()
    kit.connect()
    kit.nothing(f"but one HELLO, for {6 * kit.quiet:g} s without an answer", 6 * kit.quiet)
    kit.send(Kind.ERROR, ErrorCode.UNKNOWN_PEER, "say HELLO", seq=0)
    kit.nothing("in answer to unknown-peer while its HELLO is unanswered")
    kit.welcome(heartbeat=kit.quiet)
    kit.resume()
    kit.nothing("but HEARTBEATs after WELCOME", 5 * kit.quiet)
    kit.exchange()
    if kit.hellos != 1:
        raise Broken("one HELLO over the connection", f"{kit.hellos}")


@RULES.add(Tier.COMPLETE, "greeting", level=Requirement.SHOULD, needs=("silent-until-welcomed", "hello-once"))
def silence(kit: Harness) -> None:
    """A peer that receives nothing for WELCOME's heartbeat sends HEARTBEAT, repeatedly."""
    kit.cut()
    kit.connect()
    kit.welcome(heartbeat=0.1)
    kit.resume()
    expected = f"{_BEATS} HEARTBEATs within {_BEATS_WITHIN:g} s, with a heartbeat of 0.1 s"
    times: list[float] = []
    deadline = clock.monotonic() + kit.wait
    while len(times) < _BEATS or times[-1] - times[-_BEATS] > _BEATS_WITHIN:
        left = deadline - clock.monotonic()
        frames = kit.kept(lambda left=left: kit.connection.receive(max(0.0, left)))  # type: ignore[misc]
        if frames is None:
            raise Broken(expected, f"{len(times)} in {kit.wait:g} s")
        got = kit.decoded(frames, expected)
        if (got.kind, got.session) != (Kind.HEARTBEAT, kit.session):
            raise Broken(expected, described(got), frames)
        times.append(clock.monotonic())
    kit.cut()
    kit.reconnect()
    kit.exchange()


@RULES.add(Tier.COMPLETE, "transport", level=Requirement.SHOULD)
def idle(kit: Harness) -> None:
    """The client sleeps while it waits."""
    # Not measured by CPU time: on a busy machine a client that never sleeps may get little of it.
    awake = []
    for _ in range(_LOOKS):
        kit.nothing("without a call", kit.quiet / 12)
        awake.append(kit.client.awake())
    if None in awake:
        raise NotJudged("whether the client sleeps cannot be seen here")
    if sum(map(bool, awake)) > _LOOKS / 2:
        raise Broken(
            "a client that sleeps while it waits",
            f"one that was awake at {sum(map(bool, awake))} of {_LOOKS} looks",
        )


@RULES.add(Tier.COMPLETE, "limits-and-defaults", level=Requirement.SHOULD)
def huge_frame(kit: Harness) -> None:
    """A frame that is far too long ends the connection, before memory is allocated for it."""
    for size in (2**62, 2**40):
        kit.send_bytes(bytes([2]) + size.to_bytes(8, "big") + bytes(100))
        if not kit.connection.ends(kit.wait):
            raise Broken(f"the end of the connection after a frame of {size} bytes was announced", "nothing")
        kit.cut()
        # After that, libzmq ends a socket for good: the client may come back or not.
        code = kit.client.wait(kit.quiet)
        if code is not None and code < 0:
            raise Broken(f"an orderly end after a frame of {size} bytes", f"one by signal {-code}")
        kit.abandon()
        kit.ready()


@RULES.add(Tier.COMPLETE, "what-a-peer-must-should-and-may-do", level=Requirement.SHOULD)
def malformed(kit: Harness) -> None:
    """Malformed headers and frames are not accepted as a message, and do not crash the client."""
    for name, change in forms.SPOILED.items():
        _spoil(kit, name, change, kit.prepare)


@RULES.add(Tier.COMPLETE, "bodies", level=Requirement.SHOULD)
def malformed_bodies(kit: Harness) -> None:
    """A body that is not as long as its counts say, or whose fourth word is not zero, is not accepted."""
    for name, change in forms.SPOILED_BODIES.items():
        _spoil(kit, name, change, kit.with_body)


def _spoil(
    kit: Harness,
    name: str,
    change: Callable[[tuple[bytes, ...]], tuple[bytes, ...]],
    prepare: Callable[[], Exchange],
) -> None:
    """Send a malformed message; the client may report an error or end, but must not answer it or crash."""
    kit.ready()
    for _ in range(2):
        kit.exchange()
    exchange = prepare()
    kit.send_frames(change(exchange.frames))
    try:
        frames = kit.heard()
    except Gone:
        frames = None
        kit.cut()
    got = None if frames is None else kit.decoded(frames)
    if got is not None and got.kind is exchange.expected.kind:
        raise Broken(f"no answer to {name}", described(got), frames or ())
    if got is not None:
        kit.cut()  # The client reported an error, or said GOODBYE.
    code = kit.client.wait(kit.quiet) if kit.connected else kit.returns()
    if code is not None and code < 0:
        raise Broken(f"a client that goes on or reports an error after {name}", f"its end by signal {-code}")
    kit.abandon()
