"""Answers to steps of many sessions received at once: how many of them are sent together."""

from __future__ import annotations

from contextlib import ExitStack, closing
from threading import local

import pytest

from glue.client import sockets
from glue.client.sockets import SocketTransport
from glue.conform.hub.connection import Connection, Listener
from glue.types import Action, Observation
from glue.wire.codec import FROM_HUB, TO_HUB, decode, encode
from glue.wire.messages import Kind, Message
from tests.hubs import serving
from tests.players import ScriptedAgent
from tests.scripted.peer import TIMEOUT, framed

SESSIONS = [str(number) for number in range(100)]
SECONDS = 50e-6
"""The duration of a step, in seconds."""
OBSERVATION = Observation(ints=[3])


class Clock(local):
    """A clock set by hand, one for each thread: a client that another test left behind may sleep, too."""

    now = 0.0

    def monotonic(self) -> float:
        return self.now

    def sleep(self, seconds: float) -> None:
        self.now += seconds


class Slow(ScriptedAgent):
    """An agent whose step takes `SECONDS` of a clock."""

    def __init__(self, clock: Clock) -> None:
        super().__init__()
        self._clock = clock

    def agent_step(self, reward: float, observation: Observation) -> Action:
        self._clock.now += SECONDS
        return super().agent_step(reward, observation)


def hear(connection: Connection, kind: Kind) -> Message:
    """Return the next message of a kind."""
    while (frames := connection.receive(TIMEOUT)) is not None:
        if (message := decode(frames, TO_HUB)).kind is kind:
            return message
    raise AssertionError(f"no {kind.name} came")


def say(connection: Connection, *messages: Message) -> None:
    """Send messages in one piece."""
    connection.send_bytes(b"".join(framed(*encode(message, FROM_HUB)) for message in messages))


def test_many_slow_answers_leave_in_groups_and_not_one_by_one(monkeypatch: pytest.MonkeyPatch) -> None:
    clock, sizes, send = Clock(), [], SocketTransport._send

    def counted(transport: SocketTransport, data: bytes) -> bool:
        sizes.append(data.count(b"\x93\x06"))  # headers of AGENT_STEP
        return send(transport, data)

    monkeypatch.setattr(sockets, "clock", clock)
    monkeypatch.setattr(SocketTransport, "_send", counted)
    listener = Listener("ipc")
    agents = {session: Slow(clock) for session in SESSIONS}
    with ExitStack() as ending:
        ending.callback(listener.remove)
        ending.enter_context(serving(listener.url, agents))
        hub = listener.accept(TIMEOUT)
        assert hub is not None
        with closing(hub):
            hub.greet(TIMEOUT)
            for session in SESSIONS:
                hello = hear(hub, Kind.HELLO)
                say(hub, Message(Kind.WELCOME, session, hello.seq, (1, False, 10.0, 10.0, 10_000)))
            say(hub, Message(Kind.AGENT_MESSAGE, SESSIONS[0], 1))
            hear(hub, Kind.AGENT_MESSAGE)
            for seq in (2, 3):
                say(
                    hub, *(Message(Kind.AGENT_STEP, name, seq, (1.0,), OBSERVATION.body) for name in SESSIONS)
                )
                heard = [hear(hub, Kind.AGENT_STEP) for _ in SESSIONS]
                assert {(message.session, message.seq) for message in heard} == {(n, seq) for n in SESSIONS}
            say(hub, Message(Kind.GOODBYE, SESSIONS[0], 0, ("enough",)))
    numbers = [size for size in sizes if size]
    assert sum(numbers) == 2 * len(SESSIONS)
    assert len(numbers) <= 2 * len(SESSIONS) / 3, numbers
