"""Scenes of how any client begins and ends: the handshake, HELLO, GOODBYE and REFUSE."""

from __future__ import annotations

from typing import Final

from glue.protocol.messages import PROTOCOL_VERSION, ErrorCode, Kind
from glue.protocol.wire import TO_HUB, encode
from glue.testing.conform.hub.comparing import described
from glue.testing.conform.hub.desk import LULL, Desk
from glue.testing.conform.hub.rules import EVERYONE, Broken, Rules, Tier
from glue.testing.conform.hub.wire import Gone

__all__ = ["FIRST", "LAST"]

FIRST: Final = Rules()
"""To be judged first: without them, nothing else can be."""

LAST: Final = Rules()
"""To be judged last: the client has ended after them."""


@FIRST.add(
    "handshake",
    Tier.PLAYS,
    "appendix-zeromq-without-libzmq",
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
        raise Broken(f"HELLO with the version {PROTOCOL_VERSION}", described(greeted), frames)
    if role != desk.role:
        raise Broken(f"HELLO with the role {desk.role!s}", described(greeted), frames)
    if not isinstance(instance, bytes) or len(instance) != 16 or len(set(instance)) < 3:
        raise Broken("HELLO with an instance of 16 random bytes", described(greeted), frames)
    if not name or not codec:
        raise Broken("HELLO with a name and a codec", described(greeted), frames)
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
