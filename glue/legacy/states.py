"""The states of original programs in their roles, and the events possible in each.

A player, that is an agent or environment, is sent one call at a time. A call that arrives while the player
executes another one replaces the waiting call, if any, since the older one is no longer needed.

The protocol cannot report a failed request to an experiment. If a player was lost meanwhile, a request that
can be executed from its beginning is repeated; otherwise the connection is reset.

States and events are ints: any other enum is hashed by a Python function, which would be called several times
per message.
"""

from __future__ import annotations

from collections.abc import Mapping
from enum import IntEnum, auto
from typing import Final


class PlayerState(IntEnum):
    """The state of a player."""

    IDLE = auto()
    BUSY = auto()
    """A call has been sent, and not answered yet."""
    SUPERSEDED = auto()
    """The answer to the call is no longer needed; another call will be sent after it."""
    LEAVING = auto()
    """The answer to the call is no longer needed; the player will be terminated after it."""
    GONE = auto()


class PlayerEvent(IntEnum):
    """An event that changes the state of a player."""

    CALL = auto()
    """The hub has a call for the player."""
    ANSWER = auto()
    """The player has answered its call."""
    DISMISSED = auto()
    """The hub has sent the player GOODBYE or REFUSE."""
    LOST = auto()
    """The player has closed its connection, violated the protocol, or not answered in time."""


_P, _On = PlayerState, PlayerEvent

PLAYER: Final[Mapping[PlayerState, Mapping[PlayerEvent, PlayerState]]] = {
    _P.IDLE: {_On.CALL: _P.BUSY, _On.DISMISSED: _P.GONE, _On.LOST: _P.GONE},
    _P.BUSY: {_On.CALL: _P.SUPERSEDED, _On.ANSWER: _P.IDLE, _On.DISMISSED: _P.LEAVING, _On.LOST: _P.GONE},
    _P.SUPERSEDED: {
        _On.CALL: _P.SUPERSEDED,
        _On.ANSWER: _P.BUSY,
        _On.DISMISSED: _P.LEAVING,
        _On.LOST: _P.GONE,
    },
    _P.LEAVING: {_On.ANSWER: _P.GONE, _On.LOST: _P.GONE},
    _P.GONE: {},
}


class ExperimentState(IntEnum):
    """The state of an experiment's request."""

    IDLE = auto()
    WAITING = auto()
    """A request is in progress."""
    BEREFT = auto()
    """A request is in progress, and a player has been lost meanwhile."""
    RETRYING = auto()
    """The request has failed, and will be repeated in the next turn."""
    FAILED = auto()
    """The request has failed, and the connection will be reset in the next turn."""
    GONE = auto()


class ExperimentEvent(IntEnum):
    """An event that changes the state of an experiment."""

    REQUEST = auto()
    """The next request starts, or the last one is repeated."""
    REPLY = auto()
    """The request has succeeded."""
    PLAYER_LOST = auto()
    """The session has lost a player."""
    REPEATABLE_FAILURE = auto()
    """The request has failed; it could be repeated from its beginning."""
    FAILURE = auto()
    """The request has failed and cannot be repeated, for example because it continues a void episode."""
    LEFT = auto()
    """The experiment has left, violated the protocol, or been dismissed by the hub."""


_E, _When = ExperimentState, ExperimentEvent

EXPERIMENT: Final[Mapping[ExperimentState, Mapping[ExperimentEvent, ExperimentState]]] = {
    _E.IDLE: {_When.REQUEST: _E.WAITING, _When.PLAYER_LOST: _E.IDLE, _When.LEFT: _E.GONE},
    _E.WAITING: {
        _When.REPLY: _E.IDLE,
        _When.PLAYER_LOST: _E.BEREFT,
        _When.REPEATABLE_FAILURE: _E.FAILED,
        _When.FAILURE: _E.FAILED,
        _When.LEFT: _E.GONE,
    },
    _E.BEREFT: {
        _When.REPLY: _E.IDLE,
        _When.PLAYER_LOST: _E.BEREFT,
        _When.REPEATABLE_FAILURE: _E.RETRYING,
        _When.FAILURE: _E.FAILED,
        _When.LEFT: _E.GONE,
    },
    _E.RETRYING: {_When.REQUEST: _E.WAITING, _When.PLAYER_LOST: _E.RETRYING, _When.LEFT: _E.GONE},
    _E.FAILED: {_When.PLAYER_LOST: _E.FAILED, _When.LEFT: _E.GONE},
    _E.GONE: {},
}
