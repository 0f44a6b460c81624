"""A client's dialogue with a hub in memory, which a test plays as a script."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Generator, Mapping
from typing import Any

import pytest

from glue.client.experiment import RemoteExperiment, connect_over
from glue.client.players import _serve
from glue.client.target import Target
from glue.system import clock
from glue.system.spinning import Spin
from glue.wire.messages import Kind, Message, Role

HEARTBEAT = 1.0

Script = Generator[Kind | None, Message, Any]
"""What a hub does: it yields the kind of the client's next message, or None for any, and is sent it."""


class Dialogue:
    """A transport whose other end is a script; the time passes only while both wait.

    HEARTBEATs are dropped unless the script asks for one. At its end the hub says goodbye.
    """

    connected = True

    def __init__(self, script: Callable[[Dialogue], Script], *sessions: str) -> None:
        self.connections = 1
        self.now = 0.0
        self.over = False
        self._wait = HEARTBEAT
        self._inbox: deque[Message] = deque()
        self._sent: deque[Message] = deque()
        self._later: list[tuple[float, Message]] = []
        self._script = self._conversation(script, sessions)
        self._wanted = next(self._script)

    def _conversation(self, script: Callable[[Dialogue], Script], sessions: tuple[str, ...]) -> Script:
        for session in sessions:
            yield from self.welcome(session=session)
        yield from script(self)

    # What the script may do.

    def say(
        self, kind: Kind, seq: int = 0, *scalars: Any, body: bytes = b"", session: str = "default"
    ) -> None:
        """Send a message to the client."""
        self._inbox.append(Message(kind, session, seq, scalars, body))

    def say_later(self, when: float, message: Message) -> None:
        """Send a message at a time, when all other messages have been read."""
        self._later.append((when, message))

    def welcome(self, resumed: bool = False, session: str = "default") -> Script:
        """Welcome the client; return its HELLO."""
        hello = yield Kind.HELLO
        assert hello.session == session
        self.say(Kind.WELCOME, hello.seq, 1, resumed, HEARTBEAT, 10.0, 10_000, session=session)
        return hello

    def call(
        self, kind: Kind, seq: int, *scalars: Any, body: bytes = b"", session: str = "default"
    ) -> Script:
        """Call a player; return its answer."""
        self.say(kind, seq, *scalars, body=body, session=session)
        answer = yield kind
        assert answer.session == session
        return answer

    def reconnect(self) -> None:
        """Lose the connection with all that is on its way, and be there over another one."""
        self.connections += 1
        self._inbox.clear()
        self._sent.clear()

    # The transport.

    def spin_with(self, spin: Spin) -> None:
        pass

    def wait_at_most(self, seconds: float) -> None:
        self._wait = seconds

    def send_message(self, message: Message) -> bool:
        self._sent.append(message)
        return True

    def receive_message(self, max_body: int) -> Message | None:
        while self._sent and not self._inbox:
            self._take(self._sent.popleft())
        if not self._inbox:
            self.now += self._wait
            self._inbox += [message for when, message in self._later if when <= self.now]
            self._later = [later for later in self._later if later[0] > self.now]
            assert self.now < 1000, f"the hub waits for {self._wanted!r}, and the client for the hub"
            return None
        return self._inbox.popleft()

    def close(self, linger: float | None = None) -> None:
        while self._sent:
            self._take(self._sent.popleft())

    def _take(self, message: Message) -> None:
        if self.over or (message.kind is Kind.HEARTBEAT and self._wanted is not Kind.HEARTBEAT):
            return
        assert self._wanted in (None, message.kind), message
        try:
            self._wanted = self._script.send(message)
        except StopIteration:
            self.over = True
            self.say(Kind.GOODBYE, 0, "the test is over", session=message.session)


def serve(script: Callable[[Dialogue], Script], players: Any, role: Role = Role.AGENT, **how: Any) -> str:
    """Serve a player, or one in each session, whom the hub has welcomed; return the hub's goodbye."""
    served = players if isinstance(players, Mapping) else {"default": players}
    return greet(script, served, role, *served, **how)


def greet(
    script: Callable[[Dialogue], Script],
    players: Mapping[str, Any],
    role: Role = Role.AGENT,
    *welcomed: str,
    wait: float | None = None,
) -> str:
    """Serve players at a hub that has welcomed them only in the sessions named."""
    hub = Dialogue(script, *welcomed)
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(clock, "monotonic", lambda: hub.now)
        reason = _serve(role, players, Target("tcp://hub:1", "default"), wait, None, None, None, hub)
    assert hub.over
    return reason


def experiment(
    script: Callable[[Dialogue], Script], verbs: Callable[[RemoteExperiment], Any], **how: Any
) -> Any:
    """Return what an experiment makes of its verbs at a hub that has welcomed it."""
    hub = Dialogue(script, "default")
    with connect_over(hub, **how) as glue:
        result = verbs(glue)
    assert hub.over
    return result
