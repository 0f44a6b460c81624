"""The states of original programs in their roles, and what may happen in each.

A player, that is an agent or environment, is sent one call at a time. A call that arrives while it works on
another one replaces the call that waits behind it, since the older one is no longer needed.

An experiment cannot be sent the failure of a request. If a player was lost meanwhile, a request that can be
carried out from its beginning is made again; otherwise the connection is reset.

States and events are numbers: tables of any other enum would be looked up by a function in Python, several
times for each message.
"""

from __future__ import annotations

from collections.abc import Mapping
from enum import IntEnum, auto
from typing import Final, TypeVar

__all__ = [
    "EXPERIMENT",
    "PLAYER",
    "ExperimentEvent",
    "ExperimentState",
    "PlayerEvent",
    "PlayerState",
    "after",
]


class PlayerState(IntEnum):
    """What a player is doing."""

    IDLE = auto()
    BUSY = auto()
    """It has been sent a call."""
    SUPERSEDED = auto()
    """Its answer is no longer needed, and another call is to be sent after it."""
    LEAVING = auto()
    """Its answer is no longer needed, and it is terminated after it."""
    GONE = auto()


class PlayerEvent(IntEnum):
    """What happens to a player."""

    CALL = auto()
    """The hub has a call for it."""
    ANSWER = auto()
    """It has answered the call that it was sent."""
    DISMISSED = auto()
    """The hub has said goodbye to it, or refused it."""
    LOST = auto()
    """It has closed its connection, or broken the protocol."""


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
    """What becomes of an experiment's requests."""

    IDLE = auto()
    WAITING = auto()
    """A request is being carried out."""
    BEREFT = auto()
    """A request is being carried out, and a player has been lost meanwhile."""
    RETRYING = auto()
    """The request has failed, and is made again in the next turn."""
    FAILED = auto()
    """The request has failed, and the connection is reset in the next turn."""
    GONE = auto()


class ExperimentEvent(IntEnum):
    """What happens to an experiment."""

    REQUEST = auto()
    """Its next request is taken up, or the last one again."""
    REPLY = auto()
    """The request has succeeded."""
    PLAYER_LOST = auto()
    """The session has lost a player."""
    REPEATABLE_FAILURE = auto()
    """The request has failed; it could be carried out again from its beginning."""
    FAILURE = auto()
    """The request has failed for good, for instance since it goes on with an episode that is void."""
    LEFT = auto()
    """It has left, broken the protocol, or been sent away by the hub."""


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

State = TypeVar("State")
Event = TypeVar("Event")


def after(table: Mapping[State, Mapping[Event, State]], state: State, event: Event) -> State:
    """Return the state that follows `state` when `event` happens.

    Raises:
        KeyError: it cannot happen in that state; check `event in table[state]` where a program decides.
    """
    return table[state][event]
