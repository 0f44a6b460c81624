"""Masks and extras of observations, by the capabilities of those who send and read them."""

from __future__ import annotations

from collections.abc import Container

from glue.types import BESIDE_AT, NOTHING_BESIDE, beside_sizes, without_beside
from glue.wire.messages import EXTRAS, MASK, Message


def beside_without(body: bytes, capabilities: Container[str]) -> str:
    """Return the capability that the sender of an observation lacks for a part of it; "" if none."""
    mask, extras = beside_sizes(body)
    if not mask or MASK in capabilities:
        return EXTRAS if extras and EXTRAS not in capabilities else ""
    return MASK


def readable(body: bytes, capabilities: Container[str]) -> bytes:
    """Return the body of an observation without what a peer with these capabilities does not read."""
    if body.startswith(NOTHING_BESIDE, BESIDE_AT):
        return body  # the usual case
    return without_beside(body, mask=MASK not in capabilities, extras=EXTRAS not in capabilities)


def readable_by_agent(body: bytes, capabilities: Container[str]) -> bytes:
    """Return the body of an observation as an agent with these capabilities sees it: never with extras."""
    return without_beside(body, mask=MASK not in capabilities, extras=True)


def carried(welcome: Message) -> frozenset[str]:
    """Return the capabilities that a hub confirms in a WELCOME; an older hub confirms none."""
    confirmed = welcome.scalars[5:]
    return frozenset(map(str, confirmed[0])) if confirmed and isinstance(confirmed[0], tuple) else frozenset()
