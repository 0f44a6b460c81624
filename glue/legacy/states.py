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


PLAYER: Final[Mapping[PlayerState, Mapping[PlayerEvent, PlayerState]]] = {
    PlayerState.IDLE: {
        PlayerEvent.CALL: PlayerState.BUSY,
        PlayerEvent.DISMISSED: PlayerState.GONE,
        PlayerEvent.LOST: PlayerState.GONE,
    },
    PlayerState.BUSY: {
        PlayerEvent.CALL: PlayerState.SUPERSEDED,
        PlayerEvent.ANSWER: PlayerState.IDLE,
        PlayerEvent.DISMISSED: PlayerState.LEAVING,
        PlayerEvent.LOST: PlayerState.GONE,
    },
    PlayerState.SUPERSEDED: {
        PlayerEvent.CALL: PlayerState.SUPERSEDED,
        PlayerEvent.ANSWER: PlayerState.BUSY,
        PlayerEvent.DISMISSED: PlayerState.LEAVING,
        PlayerEvent.LOST: PlayerState.GONE,
    },
    PlayerState.LEAVING: {
        PlayerEvent.ANSWER: PlayerState.GONE,
        PlayerEvent.LOST: PlayerState.GONE,
    },
    PlayerState.GONE: {},
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


EXPERIMENT: Final[Mapping[ExperimentState, Mapping[ExperimentEvent, ExperimentState]]] = {
    ExperimentState.IDLE: {
        ExperimentEvent.REQUEST: ExperimentState.WAITING,
        ExperimentEvent.PLAYER_LOST: ExperimentState.IDLE,
        ExperimentEvent.LEFT: ExperimentState.GONE,
    },
    ExperimentState.WAITING: {
        ExperimentEvent.REPLY: ExperimentState.IDLE,
        ExperimentEvent.PLAYER_LOST: ExperimentState.BEREFT,
        ExperimentEvent.REPEATABLE_FAILURE: ExperimentState.FAILED,
        ExperimentEvent.FAILURE: ExperimentState.FAILED,
        ExperimentEvent.LEFT: ExperimentState.GONE,
    },
    ExperimentState.BEREFT: {
        ExperimentEvent.REPLY: ExperimentState.IDLE,
        ExperimentEvent.PLAYER_LOST: ExperimentState.BEREFT,
        ExperimentEvent.REPEATABLE_FAILURE: ExperimentState.RETRYING,
        ExperimentEvent.FAILURE: ExperimentState.FAILED,
        ExperimentEvent.LEFT: ExperimentState.GONE,
    },
    ExperimentState.RETRYING: {
        ExperimentEvent.REQUEST: ExperimentState.WAITING,
        ExperimentEvent.PLAYER_LOST: ExperimentState.RETRYING,
        ExperimentEvent.LEFT: ExperimentState.GONE,
    },
    ExperimentState.FAILED: {
        ExperimentEvent.PLAYER_LOST: ExperimentState.FAILED,
        ExperimentEvent.LEFT: ExperimentState.GONE,
    },
    ExperimentState.GONE: {},
}


class Sending(IntEnum):
    """The way in which an experiment sends requests, which tells whether it may still wait for replies."""

    ONE_BY_ONE = auto()
    """Each request was sent after the reply to the previous one."""
    AHEAD = auto()
    """The newest request was sent before the reply to the previous one, or is followed by another."""
    CLOSED = auto()
    """The sending half is closed, and the experiment waits for replies."""
    OVER = auto()
    """The connection is closed, or its sending half was closed after the last reply."""


class SendingEvent(IntEnum):
    """A request from an experiment, or the end of its data."""

    REQUEST = auto()
    """A request that no other data follows."""
    REQUEST_AHEAD = auto()
    """A request that was sent before a reply, or is followed by another."""
    END = auto()
    """The end of the data, or of the connection, while a reply is outstanding."""
    END_AFTER_REPLIES = auto()
    """The end of the data after the last reply."""


SENDING: Final[Mapping[Sending, Mapping[SendingEvent, Sending]]] = {
    # A program that waits for each reply has left if its data ends; only a program that sends requests ahead
    # closes its sending half while it still needs the other half.
    Sending.ONE_BY_ONE: {
        SendingEvent.REQUEST: Sending.ONE_BY_ONE,
        SendingEvent.REQUEST_AHEAD: Sending.AHEAD,
        SendingEvent.END: Sending.OVER,
        SendingEvent.END_AFTER_REPLIES: Sending.OVER,
    },
    Sending.AHEAD: {
        SendingEvent.REQUEST: Sending.ONE_BY_ONE,
        SendingEvent.REQUEST_AHEAD: Sending.AHEAD,
        SendingEvent.END: Sending.CLOSED,
        SendingEvent.END_AFTER_REPLIES: Sending.OVER,
    },
    Sending.CLOSED: {
        SendingEvent.REQUEST: Sending.CLOSED,
        SendingEvent.REQUEST_AHEAD: Sending.CLOSED,
        SendingEvent.END: Sending.OVER,
        SendingEvent.END_AFTER_REPLIES: Sending.OVER,
    },
    Sending.OVER: {},
}
