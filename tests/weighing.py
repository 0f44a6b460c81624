"""Whether a hub's account of its memory is true: what each holder accounts for, and what it weighs."""

from __future__ import annotations

import gc
import sys
from collections import deque
from collections.abc import Iterable
from enum import Enum
from types import GeneratorType, MethodType
from typing import Any, Final

from glue.hub.channel import Memory
from glue.hub.config import Bind, HubConfig, Keys
from glue.hub.io import channels
from glue.hub.io.log import Log
from glue.hub.io.loop import Loop
from glue.hub.io.server import Hub
from glue.hub.session import Peer, Session
from glue.hub.sessions import Sessions
from glue.legacy.codec import TO
from glue.legacy.peers import LegacyPeer
from glue.legacy.pending import Pending
from glue.wire.codec import FROM_HUB, TO_HUB

_OURS: Final = ("glue.hub", "glue.wire", "glue.engine", "glue.legacy")
_CONTAINERS: Final = (dict, list, tuple, set, frozenset, deque, GeneratorType, MethodType)
_PLAIN: Final = (bytes, bytearray, str, int, float)
_SHARED: Final = (
    *(type, Enum, Hub, HubConfig, Bind, Keys, Memory, Loop, Log, Sessions, channels.Channels, Pending),
)
_VOCABULARIES: Final = (TO_HUB, FROM_HUB, *TO.values())
"""What all holders share; none of them weighs it."""

_HOLDERS: Final = (Session, channels._SocketChannel, LegacyPeer)

_SPARE: Final = 131_072
"""Bytes by which an account may exceed the truth, besides the allowances: a read that is half worked off."""


def check(hub: Hub) -> None:
    """Raise AssertionError unless each holder's account is true: no less than it weighs, and hardly more."""
    check_sessions(hub.sessions, hub._channels._open)


def check_sessions(sessions: Sessions, connections: Iterable[Any] = ()) -> None:
    """Do the same for the sessions and the connections of its hub."""
    account = sessions.memory.accounts
    found = _holders(sessions, connections)
    joined: dict[Any, list[Peer]] = {
        channel: list(peers.values()) for channel, peers in sessions._joined.items()
    }
    peers = [peer for its in joined.values() for peer in its]
    for holder in found:
        its = joined.get(holder, [])
        held, truth = account.get(holder, 0), size_of([holder, *its], [*found, *peers])
        if isinstance(holder, channels._SocketChannel) and holder.connection._glanced:
            truth -= len(holder.connection._glanced)  # it has just been read, and is acted on at once
        assert truth <= held, f"{holder} weighs {truth} bytes and accounts for {held}"
        spare = holder._base if isinstance(holder, Session) else _SPARE + len(its) * channels._PEER
        assert held <= truth * 9 // 8 + spare, f"{holder} accounts for {held} bytes and weighs {truth}"
    assert sessions.memory.total == sum(account.values())
    gone = [holder for holder in account if holder not in found]
    assert not gone, f"the hub accounts for {gone}, which it does not have"


def _holders(sessions: Sessions, connections: Iterable[Any]) -> list[Any]:
    """Return everything that holds memory at a hub, whether it accounts for it or not."""
    found = dict.fromkeys([*sessions._by_name.values(), *connections, *sessions._joined])
    return [holder for holder in found if isinstance(holder, _HOLDERS)]


def size_of(roots: Iterable[Any], others: Iterable[Any] = ()) -> int:
    """Return the sizes of all objects that hold the data of `roots`, each once, but not those of `others`."""
    left = list(roots)
    seen = {id(other) for other in others} - {id(root) for root in left}
    seen |= set(map(id, _VOCABULARIES))
    total = 0
    while left:
        each = left.pop()
        if id(each) in seen:
            continue
        seen.add(id(each))
        ours = type(each).__module__.startswith(_OURS)
        if isinstance(each, _SHARED) or not (ours or isinstance(each, (*_CONTAINERS, *_PLAIN))):
            continue
        total += sys.getsizeof(each)
        left += gc.get_referents(each)
    return total
