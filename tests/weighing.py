"""Whether a hub's account of its memory is true: what each holder accounts for, and what it weighs."""

from __future__ import annotations

import gc
import sys
from collections import deque
from collections.abc import Iterable
from enum import Enum
from types import GeneratorType, MethodType
from typing import Any, Final, NamedTuple

from glue.hub import session
from glue.hub.config import Bind, HubConfig
from glue.hub.io import channels
from glue.hub.io.log import Log
from glue.hub.io.loop import Loop
from glue.hub.io.server import Hub
from glue.hub.keys import Keys
from glue.hub.memory import Memory
from glue.hub.peer import Peer
from glue.hub.session import Session
from glue.hub.sessions import Switchboard
from glue.legacy.peers import LegacyPeer
from glue.legacy.pending import Pending
from glue.wire.codec import FROM_HUB, TO_HUB

_OURS: Final = ("glue.hub", "glue.wire", "glue.engine", "glue.legacy")
_CONTAINERS: Final = (dict, list, tuple, set, frozenset, deque, GeneratorType, MethodType)
_PLAIN: Final = (bytes, bytearray, str, int, float)
_SHARED: Final = (
    *(type, Enum, Hub, HubConfig, Bind, Keys, Memory, Loop, Log, Switchboard, channels.Channels, Pending),
)
_VOCABULARIES: Final = (TO_HUB, FROM_HUB)
"""What all holders share; none of them weighs it."""

_HOLDERS: Final = (Session, channels._Channel, LegacyPeer)

_SPARE: Final = 131_072
"""Bytes by which an account may exceed the truth, besides the allowances: a read that is half worked off."""


class Weight(NamedTuple):
    """The bytes that a holder of memory uses: by the hub's account, and by the sizes of its objects."""

    account: int
    truth: int


def weigh(hub: Hub) -> Weight:
    """Return the hub's account of its memory, and what everything that holds memory weighs together."""
    board = hub.switchboard
    peers = [peer for seats in board._seats.values() for peer in seats.values()]
    return Weight(board.memory.total, size_of([*_holders(board, hub._channels._open), *peers]))


def check(hub: Hub) -> None:
    """Raise AssertionError unless each holder's account is true: no less than it weighs, and hardly more."""
    check_board(hub.switchboard, hub._channels._open)


def check_board(board: Switchboard, connections: Iterable[Any] = ()) -> None:
    """Do the same for a switchboard and the connections of its hub."""
    account = board.memory.held
    found = _holders(board, connections)
    seats: dict[Any, list[Peer]] = {route: list(peers.values()) for route, peers in board._seats.items()}
    peers = [peer for its in seats.values() for peer in its]
    for holder in found:
        its = seats.get(holder, [])
        held, truth = account.get(holder, 0), size_of([holder, *its], [*found, *peers])
        if isinstance(holder, channels._Channel) and holder.connection._glanced:
            truth -= len(holder.connection._glanced)  # it has just been read, and is acted on at once
        assert truth <= held, f"{holder} weighs {truth} bytes and accounts for {held}"
        spare = session._BASE if isinstance(holder, Session) else _SPARE + len(its) * channels._SEAT
        assert held <= truth * 9 // 8 + spare, f"{holder} accounts for {held} bytes and weighs {truth}"
    assert board.memory.total == sum(account.values())
    gone = [holder for holder in account if holder not in found]
    assert not gone, f"the hub accounts for {gone}, which it does not have"


def _holders(board: Switchboard, connections: Iterable[Any]) -> list[Any]:
    """Return everything that holds memory at a hub, whether it accounts for it or not."""
    found = dict.fromkeys([*board._sessions.values(), *connections, *board._seats])
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
