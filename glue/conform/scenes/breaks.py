"""Scenes of broken connections, for any client."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from glue.conform.hub.connection import Connection
from glue.conform.hub.harness import Harness
from glue.conform.hub.rules import EVERYONE, Broken, Requirement, Rules, Tier
from glue.wire import zmtp
from glue.wire.messages import ErrorCode, Kind

RULES: Final = Rules(EVERYONE)


@RULES.add(Tier.SURVIVES, "greeting", needs=("silent-until-welcomed",))
def instance(kit: Harness) -> None:
    """The instance is the same over each new connection."""
    before = kit.instance
    for _ in range(2):
        kit.cut()
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
    Tier.SURVIVES,
    "breaks-replacements-and-void-episodes",
    needs=(
        "silent-until-welcomed",
        "answer-lost",
    ),
)
def call_lost(kit: Harness) -> None:
    """An incomplete message at the end of a connection is discarded: at every step of an episode."""
    for number in range(kit.exchanges()):
        exchange = kit.prepare()
        data = zmtp.encode(exchange.frames)
        kit.send_bytes(data[: 1 + number * len(data) // kit.exchanges()])
        kit.cut()
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
        kit.cut()
        kit.begin_handshake(step)
    kit.cut()
    kit.connect()  # And once after HELLO, without a WELCOME.
    kit.cut()
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
    before = kit.hellos
    kit.send(Kind.ERROR, ErrorCode.UNKNOWN_PEER, "say HELLO", seq=0)
    kit.greeted_again()
    kit.resume()
    kit.exchange()
    if kit.hellos != before + 1:
        raise Broken("one HELLO", f"{kit.hellos - before}")
