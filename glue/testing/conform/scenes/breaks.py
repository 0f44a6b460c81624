"""Scenes of broken connections, as any client meets them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from glue.protocol import zmtp
from glue.protocol.messages import ErrorCode, Kind
from glue.testing.conform.hub.desk import LULL, Desk
from glue.testing.conform.hub.rules import EVERYONE, Broken, Rules, Tier

__all__ = ["RULES"]

RULES: Final = Rules()


@RULES.add(
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


@RULES.add(
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


@RULES.add(
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


@RULES.add(
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


@RULES.add(
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


@RULES.add(
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
