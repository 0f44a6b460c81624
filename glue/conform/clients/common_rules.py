"""The rules for every client: its greeting and its end, other traffic on a connection, broken connections."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from typing import Final

from glue.conform import forms
from glue.conform.clients.connection import Connection, Gone
from glue.conform.clients.harness import BEAT, MAX_BODY, Exchange, Harness
from glue.conform.messages import described
from glue.conform.rules import Broken, NotJudged, Requirement, Rules, Tier
from glue.system import clock
from glue.wire import zmtp
from glue.wire.codec import FROM_HUB, TO_HUB, decode, encode
from glue.wire.messages import PROTOCOL_VERSION, THREE_ROLES, ErrorCode, Kind, Message

FIRST: Final = Rules(THREE_ROLES)
"""Rules about a client's start, whose scenes start clients themselves: all others depend on them."""

RULES: Final = Rules(THREE_ROLES)

LAST: Final = Rules(THREE_ROLES)
"""Rules judged last: they end the client."""


@FIRST.add(Tier.PLAYS, "appendix-zeromq-without-libzmq")
def handshake(kit: Harness) -> None:
    """ZMTP's handshake, as a DEALER; no message before the hub's READY."""
    kit.start(hold=kit.quiet)


@FIRST.add(Tier.PLAYS, "greeting")
def hello(kit: Harness) -> None:
    """HELLO comes first, with its role and 16 bytes of instance; then the client waits for WELCOME."""
    greeted = kit.start()
    versions, role, instance, name, codec, _ = greeted.scalars
    frames = encode(greeted, TO_HUB)
    if not isinstance(versions, tuple) or PROTOCOL_VERSION not in versions:
        raise Broken(f"HELLO with the version {PROTOCOL_VERSION}", described(greeted), frames)
    if role != kit.role:
        raise Broken(f"HELLO with the role {kit.role!s}", described(greeted), frames)
    if not isinstance(instance, bytes) or len(instance) != 16 or len(set(instance)) < 3:
        raise Broken("HELLO with an instance of 16 random bytes", described(greeted), frames)
    if not name or not codec:
        raise Broken("HELLO with a name and a codec", described(greeted), frames)
    kit.nothing_but_hello()
    kit.welcome(resumed=False)
    kit.begin()
    kit.exchange()


@FIRST.add(Tier.PLAYS, "greeting")
def restart(kit: Harness) -> None:
    """A restarted program has another instance."""
    kit.ready()
    before = kit.instance
    kit.drop()
    kit.ready()
    if kit.instance == before:
        raise Broken("another instance", f"that of the program before it, {before.hex()}")


@LAST.add(Tier.PLAYS, "greeting")
def goodbye(kit: Harness) -> None:
    """GOODBYE ends the client, without another message in the session."""
    kit.exchange()
    code = _said_goodbye(kit, "the hub closes")
    if code and kit.mirror:
        raise Broken("exit code 0 after GOODBYE", str(code))


@LAST.add(Tier.PLAYS, "greeting")
def refusal(kit: Harness) -> None:
    """REFUSE ends the client, with an exit code other than 0."""
    if _refused(kit, "this hub is full") == 0 and kit.mirror:
        raise Broken("an exit code other than 0 after REFUSE", "0")


@LAST.add(
    Tier.PLAYS, "what-a-peer-must-should-and-may-do", level=Requirement.SHOULD, needs=("goodbye", "refusal")
)
def reasons(kit: Harness) -> None:
    """The texts of GOODBYE and REFUSE are shown to the user."""
    kit.fresh()
    for end, reason in ((_said_goodbye, "the hub closes for good"), (_refused, "no room for mirrors here")):
        end(kit, reason)
        if reason not in kit.output():
            raise Broken(f"that it prints {reason!r}", f"{kit.output()[-300:]!r}")


def _said_goodbye(kit: Harness, reason: str) -> int:
    """Say GOODBYE to the client, and return its exit code."""
    kit.send(Kind.GOODBYE, reason)
    frames = None
    with suppress(Gone):
        frames = kit.heard(kit.wait)  # A HEARTBEAT may have been sent before GOODBYE was read.
    if frames is not None:
        raise Broken("nothing after GOODBYE", described(kit.decoded(frames)), frames)
    kit.cut()
    return _ended(kit, "GOODBYE")


def _refused(kit: Harness, reason: str) -> int:
    """Refuse a new client, and return its exit code."""
    greeted = kit.start()
    kit.send(Kind.REFUSE, ErrorCode.FULL, reason, seq=greeted.seq)
    kit.connection.ends(kit.wait)
    kit.cut()
    return _ended(kit, "REFUSE")


def _ended(kit: Harness, kind: str) -> int:
    code = kit.client.wait(kit.wait)
    if code is None:
        raise Broken(f"the client's end after {kind}", f"none in {kit.wait:g} s")
    if code < 0:
        raise Broken(f"the client's end after {kind}", f"its end by signal {-code}")
    return code


_LOOK: Final = 0.02
"""Seconds between two polls of the client's state."""

_LOOKS: Final = 50
"""Number of times that it is polled."""

_BEATS: Final = 5
_BEATS_WITHIN: Final = 1.5
"""Maximum time for the heartbeats, in seconds: generous at 0.1 s each, too short at the default of 1 s."""


@RULES.add(Tier.PLAYS, "greeting")
def heartbeats(kit: Harness) -> None:
    """HEARTBEATs are ignored at any time."""
    for _ in range(kit.exchanges()):
        exchange = kit.prepare()
        kit.send_frames(BEAT)
        kit.send(Kind.HEARTBEAT)
        kit.run(exchange)
        kit.send_frames(BEAT)


@RULES.add(Tier.SURVIVES, "appendix-zeromq-without-libzmq", needs=("heartbeats",))
def torn(kit: Harness) -> None:
    """Bytes may arrive one by one, and many messages at once."""
    for _ in range(2):
        exchange = kit.prepare()
        for byte in zmtp.encode(exchange.frames):
            kit.send_bytes(bytes([byte]))
        kit.take(exchange.expected)
    for _ in range(3):
        exchange = kit.prepare()
        kit.send_bytes(zmtp.encode(BEAT) * 200 + zmtp.encode(exchange.frames))
        kit.take(exchange.expected)


@RULES.add(Tier.SURVIVES, "transport", needs=("heartbeats",))
def crossing(kit: Harness) -> None:
    """HEARTBEATs that arrive while the client sends its frames do not block it."""
    for _ in range(kit.exchanges()):
        exchange = kit.prepare()
        kit.send_bytes(zmtp.encode(exchange.frames) + 3 * zmtp.encode(BEAT))
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
    """A body that is not as long as its counts say, those of mask and extras included, is not accepted."""
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
    code = kit.client.wait(kit.quiet) if kit.connected else _left_or_back(kit)
    if code is not None and code < 0:
        raise Broken(
            f"a client that continues or reports an error after {name}", f"its end by signal {-code}"
        )
    kit.abandon()


def _left_or_back(kit: Harness) -> int | None:
    """Wait until the client reconnects or ends; return its exit code, or None if it has reconnected."""
    deadline = clock.monotonic() + kit.wait
    while (code := kit.client.wait(_LOOK)) is None and not kit.listener.waits(_LOOK):
        if clock.monotonic() > deadline:
            raise Broken(f"the client's return or end within {kit.wait:g} s", "neither")
    try:
        if code is None:
            kit.reconnect()
    except Broken:
        # libzmq can reconnect while the client ends.
        code = kit.client.wait(max(0.0, deadline - clock.monotonic()))
        if code is None:
            raise
    return code


@RULES.add(Tier.SURVIVES, "greeting", needs=("silent-until-welcomed",))
def instance(kit: Harness) -> None:
    """The instance is the same over each new connection."""
    before = kit.instance
    for _ in range(2):
        kit.reconnect()
        if kit.instance != before:
            raise Broken(f"the instance {before.hex()} again", kit.instance.hex())
    kit.exchange()


@RULES.add(Tier.SURVIVES, "breaks-replacements-and-void-episodes", needs=("silent-until-welcomed",))
def answer_lost(kit: Harness) -> None:
    """An answer or request that is lost with its connection is sent again: at every step of an episode."""
    for number in range(kit.exchanges()):
        exchange = kit.prepare()
        frames = kit.run(exchange)
        kit.cut(reset=number % 2 == 1)
        kit.connect()
        kit.welcome()
        kit.repeat(exchange, frames)


@RULES.add(
    Tier.SURVIVES, "breaks-replacements-and-void-episodes", needs=("silent-until-welcomed", "answer-lost")
)
def call_lost(kit: Harness) -> None:
    """An incomplete message at the end of a connection is discarded: at every step of an episode."""
    for number in range(kit.exchanges()):
        exchange = kit.prepare()
        data = zmtp.encode(exchange.frames)
        kit.send_bytes(data[: 1 + number * len(data) // kit.exchanges()])
        kit.reconnect()
        kit.run(exchange)


@RULES.add(Tier.SURVIVES, "transport", needs=("silent-until-welcomed",))
def handshakes_lost(kit: Harness) -> None:
    """A connection may end at any point of its handshake and greeting."""
    steps: list[Callable[[Connection], None]] = [
        lambda connection: None,
        lambda connection: connection.send_bytes(zmtp.GREETING[:10]),
        lambda connection: connection.send_bytes(zmtp.GREETING),
        lambda connection: connection.greet(kit.wait),
    ]
    for step in steps:
        with suppress(Gone):  # libzmq sometimes gives a connection up before its greeting
            step(kit.accept())
    kit.connect()  # And once after HELLO, without a WELCOME.
    kit.reconnect()
    kit.exchange()


@RULES.add(Tier.SURVIVES, "transport", level=Requirement.SHOULD, needs=("silent-until-welcomed",))
def absent(kit: Harness) -> None:
    """The client waits for a hub that is absent for a while."""
    kit.listener.close()
    try:
        kit.cut()
        code = kit.client.wait(2 * kit.quiet)
    finally:
        kit.listener.open()
    if code is not None:
        raise Broken("a client that waits for the hub", f"its end, with exit code {code}")
    kit.reconnect()
    kit.exchange()


@RULES.add(Tier.SURVIVES, "greeting", needs=("silent-until-welcomed",))
def unknown_peer(kit: Harness) -> None:
    """The error unknown-peer is answered with HELLO, over the same connection."""
    kit.greet_again()
    kit.exchange()
    if kit.hellos != 1:
        raise Broken("one HELLO", f"{kit.hellos}")
