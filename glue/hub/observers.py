"""Observers of a session: the messages that they are shown, and their number.

An observer asks for a number of moments, and is shown the next ones; it misses all others. An observer that
asks thirty times a second thus costs the session thirty messages a second, however fast it plays. A message
that cannot be sent at once, because the observer has not read the previous ones, is missed, too: no messages
are kept for it. Nor may observers exhaust the hub's memory: a message for which there is no room is missed.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from glue.engine.engine import Engine
from glue.hub.memory import Memory
from glue.wire.codec import clip
from glue.wire.messages import Kind, Message, Value

if TYPE_CHECKING:
    from glue.hub.peer import Peer

MAX_OBSERVERS: Final = 8
"""Maximum number of observers of one session."""

_COPIES: Final = 2
"""Maximum number of copies of a message that exist while it is sent, the encrypted one included."""


@dataclass(slots=True)
class _View:
    """Number of moments that an observer still wants, number of the latest, and whether it lacks the spec."""

    wanted: int = 0
    number: int = 0
    spec_due: bool = True


class Observers:
    """The observers of one session. Moments and answers are numbered for each; a missed one leaves a gap.

    Args:
        session: the session's name.
        send: sends a message to an observer; returns False if it is gone or has not read the previous ones.
        memory: the hub's; what it has no room for is missed.
    """

    def __init__(self, session: str, send: Callable[[Peer, Message], bool], memory: Memory) -> None:
        self._session = session
        self._send = send
        self._memory = memory
        self._views: dict[Peer, _View] = {}
        self._episode = 0  # number of episodes begun since the first observer joined

    @property
    def peers(self) -> list[Peer]:
        """The observers of the session."""
        return list(self._views)

    def join(self, peer: Peer, engine: Engine) -> None:
        """Let `peer` observe, and send it the task spec, if there is one."""
        self._views[peer] = _View()
        self._tell_spec(engine)

    def leave(self, peer: Peer) -> None:
        """Forget `peer`."""
        del self._views[peer]

    def want(self, peer: Peer, moments: int) -> None:
        """Show `peer` the next `moments` moments, in place of any earlier request."""
        self._views[peer].wanted = moments

    def show(self, call: Message, scalars: tuple[Value, ...], body: bytes, engine: Engine) -> None:
        """Show the answer to `call`, which `engine` has received, if observers are shown such answers."""
        kind = call.kind
        if kind is Kind.ENV_STEP:
            counters = (self._episode, engine.num_steps, engine.total_reward)
            self._show(Kind.OBSERVED_STEP, (*counters, *scalars), body, call.body)
        elif kind is Kind.ENV_START:
            self._episode += 1
            self._tell_spec(engine)  # to observers to which it could not be sent before
            self._show(Kind.OBSERVED_START, (self._episode,), body)
        elif kind is Kind.ENV_INIT:
            for view in self._views.values():
                view.spec_due = True
            self._tell_spec(engine)
        elif kind is Kind.AGENT_MESSAGE:
            message = clip(call.body.decode(errors="replace"))
            for peer, view in self._views.items():
                self._tell(peer, view, Kind.OBSERVED_MESSAGE, (message,), body)

    def _show(self, kind: Kind, scalars: tuple[Value, ...], *bodies: bytes) -> None:
        """Show a moment to the observers that want one."""
        for peer, view in self._views.items():
            if not view.wanted:
                view.number += 1
            elif self._tell(peer, view, kind, scalars, *bodies):
                view.wanted -= 1

    def _tell_spec(self, engine: Engine) -> None:
        for peer, view in self._views.items():
            if view.spec_due and engine.task_spec is not None:
                view.spec_due = not self._deliver(peer, Kind.OBSERVED_INIT, 0, (), engine.task_spec)

    def _tell(self, peer: Peer, view: _View, kind: Kind, scalars: tuple[Value, ...], *bodies: bytes) -> bool:
        view.number += 1
        return self._deliver(peer, kind, view.number, scalars, *bodies)

    def _deliver(self, peer: Peer, kind: Kind, seq: int, scalars: tuple[Value, ...], *bodies: bytes) -> bool:
        if not self._memory.has_room(_COPIES * sum(map(len, bodies))):
            return False
        return self._send(peer, Message(kind, self._session, seq, scalars, b"".join(bodies)))
