"""Observers of a session: the messages that they are shown, and their number.

An observer asks for a number of moments, and is shown the next ones; it misses all others. An observer that
asks thirty times a second thus costs the session thirty messages a second, however fast it plays. A message
that cannot be sent at once, because the observer has not read the previous ones, is missed, too: no messages
are kept for it. Nor may observers exhaust the hub's memory: a message for which there is no room is missed.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from glue.engine.engine import Engine
from glue.hub.channel import Channel, Memory
from glue.wire.beside import readable
from glue.wire.codec import clip
from glue.wire.messages import Kind, Message, Value

MAX_OBSERVERS: Final = 8
"""Maximum number of observers of one session."""

_COPIES: Final = 2
"""Maximum number of copies of a message that exist while it is sent, the encrypted one included."""


@dataclass(slots=True)
class _Observer:
    """Number of moments that an observer still wants, number of the latest, and whether it lacks the spec."""

    channel: Channel
    capabilities: frozenset[str]
    wanted: int = 0
    number: int = 0
    spec_due: bool = True


class Observers:
    """The observers of one session. Moments and answers are numbered for each; a missed one leaves a gap.

    Args:
        session: the session's name.
        memory: the hub's; what it has no room for is missed.
    """

    def __init__(self, session: str, memory: Memory) -> None:
        self._session = session
        self._memory = memory
        self._all: dict[Channel, _Observer] = {}
        self._episode = 0  # number of episodes begun since the first observer joined

    @property
    def channels(self) -> list[Channel]:
        """The channels of the observers."""
        return list(self._all)

    def join(self, channel: Channel, capabilities: frozenset[str], engine: Engine) -> None:
        """Let the peer of `channel` observe, and send it the task spec, if there is one."""
        self._all[channel] = _Observer(channel, capabilities)
        self._tell_spec(engine)

    def leave(self, channel: Channel) -> None:
        """Forget `channel`."""
        del self._all[channel]

    def want(self, channel: Channel, moments: int) -> None:
        """Show `channel` the next `moments` moments, in place of any earlier request."""
        self._all[channel].wanted = moments

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
            for observer in self._all.values():
                observer.spec_due = True
            self._tell_spec(engine)
        elif kind is Kind.AGENT_MESSAGE:
            message = clip(call.body.decode(errors="replace"))
            for observer in self._all.values():
                self._tell(observer, Kind.OBSERVED_MESSAGE, (message,), body)

    def _show(self, kind: Kind, scalars: tuple[Value, ...], observation: bytes, action: bytes = b"") -> None:
        for observer in self._all.values():
            if not observer.wanted:
                observer.number += 1
            elif self._tell(observer, kind, scalars, readable(observation, observer.capabilities), action):
                observer.wanted -= 1

    def _tell(self, observer: _Observer, kind: Kind, scalars: tuple[Value, ...], *bodies: bytes) -> bool:
        observer.number += 1
        return self._deliver(
            observer.channel, Message(kind, self._session, observer.number, scalars), *bodies
        )

    def _tell_spec(self, engine: Engine) -> None:
        message = Message(Kind.OBSERVED_INIT, self._session, 0)
        for observer in self._all.values():
            if observer.spec_due and engine.task_spec is not None:
                observer.spec_due = not self._deliver(observer.channel, message, engine.task_spec)

    def _deliver(self, channel: Channel, message: Message, *bodies: bytes) -> bool:
        if not self._memory.has_room(_COPIES * sum(map(len, bodies))):
            return False
        return channel.deliver(message._replace(body=b"".join(bodies)))
