"""What observations carry beside their numbers, by the capabilities of those who send and read them."""

from __future__ import annotations

from collections.abc import Set

from glue.types import beside_sizes, has_beside, without_beside
from glue.wire.messages import EXTRAS, MASK, Message


def beside_of(body: bytes) -> frozenset[str]:
    """Return the capabilities that the sender of an observation with this body needs."""
    sizes = zip((MASK, EXTRAS), beside_sizes(body), strict=True)
    return frozenset(capability for capability, size in sizes if size)


def readable(body: bytes, capabilities: Set[str]) -> bytes:
    """Return the body of an observation without what a peer with these capabilities does not read."""
    if not has_beside(body):
        return body
    return without_beside(body, mask=MASK not in capabilities, extras=EXTRAS not in capabilities)


def readable_by_agent(body: bytes, capabilities: Set[str]) -> bytes:
    """Return the body of an observation as an agent with these capabilities sees it: never with extras."""
    return without_beside(body, mask=MASK not in capabilities, extras=True)


def carried(welcome: Message) -> frozenset[str]:
    """Return the capabilities that a hub confirms in a WELCOME; an older hub confirms none."""
    confirmed = welcome.scalars[5:]
    return frozenset(map(str, confirmed[0])) if confirmed and isinstance(confirmed[0], tuple) else frozenset()
