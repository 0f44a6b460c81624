"""The kit as the hub of an agent or environment that mirrors (docs/clients.md)."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import cycle
from typing import Any, Final

from glue.client.bodies import READ, write
from glue.core.calls import role_calls
from glue.protocol.messages import CALLS, Message, Role, Value
from glue.protocol.wire import FROM_HUB, encode
from glue.testing.conform.hub.clients import Start
from glue.testing.conform.hub.desk import Desk, Exchange
from glue.testing.conform.hub.rules import PLAYERS
from glue.testing.conform.hub.wire import Listener
from glue.testing.mirror import MirrorAgent, MirrorEnvironment
from glue.types import Action, Observation

__all__ = ["SHOWN", "SPEC", "PlayerDesk"]

_KINDS: Final = {
    role: {kind.name.partition("_")[2]: kind for kind, call in CALLS.items() if call.callee is role}
    for role in PLAYERS
}
"""A role's calls, by what their names have beyond the role."""

SPEC: Final = "a task for a mirror, größer als nötig".encode()
SHOWN: Final = Observation(chars=b"ab")
"""What a player is shown where nothing else matters: whoever confuses numbers still understands it."""


class PlayerDesk(Desk):
    """What the mirror should answer is what ours answers; see `glue.testing.mirror`."""

    def __init__(self, role: Role, start: Start, listener: Listener, wait: float) -> None:
        super().__init__(role, start, listener, wait)
        self.kinds = _KINDS[role]
        self.seq = 0

    def begin(self) -> None:
        model: Any = MirrorAgent() if self.role is Role.AGENT else MirrorEnvironment()
        self._handlers = role_calls(self.role, model)
        self._plot: Iterator[tuple[str, tuple[Value, ...], bytes]] = cycle(self._episode())
        self.seq = 0

    def _episode(self) -> list[tuple[str, tuple[Value, ...], bytes]]:
        if self.role is Role.AGENT:
            return [
                ("INIT", (), SPEC),
                ("START", (), SHOWN.body),
                ("STEP", (0.0,), SHOWN.body),
                ("MESSAGE", (), b"how are you?"),
                ("STEP", (0.0,), Observation(chars=b"c").body),
                ("END", (0.0,), b""),
                ("START", (), SHOWN.body),
                ("CLEANUP", (), b""),
            ]
        return [
            ("INIT", (), b""),
            ("START", (), b""),
            ("STEP", (), SHOWN.body),
            ("MESSAGE", (), b"how are you?"),
            ("STEP", (), Observation(chars=b"c").body),
            ("START", (), b""),
            ("CLEANUP", (), b""),
        ]

    def exchanges(self) -> int:
        return len(self._episode())

    def prepare(self) -> Exchange:
        name, scalars, body = next(self._plot)
        return self.call(name, *scalars, body=body)

    def call(self, name: str, *scalars: Value, body: bytes = b"", seq: int | None = None) -> Exchange:
        """Return a call, by default with the next number, and its answer."""
        self.seq = self.seq + 1 if seq is None else seq
        kind = self.kinds[name]
        values, result = self._handlers[kind](scalars, READ[CALLS[kind].request.body](body))
        asked = Message(kind, self.session, self.seq, scalars, body)
        answer = Message(kind, self.session, self.seq, values, write(result))
        return Exchange(encode(asked, FROM_HUB), answer)

    def ask(self, name: str, *scalars: Value, body: bytes = b"", seq: int | None = None) -> Sequence[bytes]:
        """Call, and expect the answer; return its frames."""
        exchange = self.call(name, *scalars, body=body, seq=seq)
        self.send_frames(exchange.frames)
        return self.take(exchange.expected)

    def step(self, shown: Observation | Action, reward: float = 0.0) -> Exchange:
        """Return a step that shows this to the player."""
        scalars = (reward,) if self.role is Role.AGENT else ()
        return self.call("STEP", *scalars, body=shown.body)

    def steps(self, *all_shown: Observation | Action) -> None:
        """Ask for a step with each of these."""
        for each in all_shown:
            exchange = self.step(each)
            self.send_frames(exchange.frames)
            self.take(exchange.expected)

    def settle(self) -> None:
        pass

    def resume(self) -> None:
        pass

    def repeat(self, exchange: Exchange, frames: Sequence[bytes]) -> None:
        self.send_frames(exchange.frames)
        self.take(exchange.expected)

    def took(self, message: Message) -> None:
        pass
