"""Scenes of the beginning and the end of any client: the handshake, HELLO, GOODBYE and REFUSE."""

from __future__ import annotations

from typing import Final

from glue.conform.hub.comparing import described
from glue.conform.hub.connection import Gone
from glue.conform.hub.harness import Harness
from glue.conform.hub.rules import EVERYONE, Broken, Requirement, Rules, Tier
from glue.wire.codec import TO_HUB, encode
from glue.wire.messages import PROTOCOL_VERSION, ErrorCode, Kind

FIRST: Final = Rules(EVERYONE)
"""Rules judged first: all others depend on them."""

LAST: Final = Rules(EVERYONE)
"""Rules judged last: they end the client."""


@FIRST.add(Tier.PLAYS, "appendix-zeromq-without-libzmq")
def handshake(kit: Harness) -> None:
    """ZMTP's handshake, as a DEALER; no message before the hub's READY."""
    kit.drop()
    kit.start()
    kit.connect(hold=kit.quiet)


@FIRST.add(Tier.PLAYS, "greeting")
def hello(kit: Harness) -> None:
    """HELLO comes first, with its role and 16 bytes of instance; then the client waits for WELCOME."""
    kit.drop()
    kit.start()
    greeted = kit.connect()
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
    try:
        frames = kit.heard(kit.wait)  # A HEARTBEAT may have been sent before GOODBYE was read.
    except Gone:
        frames = None
    if frames is not None:
        raise Broken("nothing after GOODBYE", described(kit.decoded(frames)), frames)
    kit.cut()
    return _ended(kit, "GOODBYE")


def _refused(kit: Harness, reason: str) -> int:
    """Refuse a new client, and return its exit code."""
    kit.drop()
    kit.start()
    greeted = kit.connect()
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
