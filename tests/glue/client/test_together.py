"""Answers to steps of many sessions that were received at once: how many of them are sent together."""

from __future__ import annotations

import socket
import threading
from collections.abc import Sequence
from typing import Any

import pytest

from glue.client import answers
from glue.client.link import Link
from glue.client.players import serve_agent
from glue.protocol import zmtp
from glue.protocol.messages import Kind, Message
from glue.protocol.wire import FROM_HUB, TO_HUB, decode, encode
from glue.types import Action, Observation
from tests.players import ScriptedAgent

SESSIONS = [str(number) for number in range(100)]
SECONDS = 50e-6
"""What a step takes."""
OBSERVATION = Observation(ints=[3])


class Clock:
    """A clock that is set by hand."""

    now = 0.0

    def monotonic(self) -> float:
        return self.now


class Slow(ScriptedAgent):
    """Takes its time for a step, by a clock."""

    def __init__(self, clock: Clock) -> None:
        super().__init__()
        self._clock = clock

    def agent_step(self, reward: float, observation: Observation) -> Action:
        self._clock.now += SECONDS
        return super().agent_step(reward, observation)


class RawHub:
    """The hub's end of a connection, so that what it sends at once arrives at once."""

    def __init__(self, connected: socket.socket) -> None:
        self._socket = connected
        self._decoder = zmtp.Decoder(zmtp.ROUTER, 2**20)
        connected.settimeout(30)
        connected.sendall(zmtp.GREETING)

    def hear(self, kind: Kind) -> Message:
        """The next message of a kind."""
        while True:
            event = self._decoder.next_event()
            if isinstance(event, bytes):
                self._socket.sendall(event)
            elif event is None:
                self._decoder.receive_data(self._socket.recv(65_536))
            elif (message := decode(event, TO_HUB)).kind is kind:
                return message

    def say(self, *messages: Message) -> None:
        """Send messages in one piece."""
        self._socket.sendall(b"".join(zmtp.encode(encode(message, FROM_HUB)) for message in messages))


def test_many_slow_answers_leave_in_groups_and_not_one_by_one(monkeypatch: pytest.MonkeyPatch) -> None:
    clock, numbers, send = Clock(), [], Link.send_steps

    def counted(link: Link, steps: Sequence[Any]) -> None:
        numbers.append(len(steps))
        send(link, steps)

    monkeypatch.setattr(answers, "time", clock)
    monkeypatch.setattr(Link, "send_steps", counted)
    with socket.create_server(("127.0.0.1", 0)) as server:
        url = f"tcp://127.0.0.1:{server.getsockname()[1]}"
        agents = {session: Slow(clock) for session in SESSIONS}
        serving = threading.Thread(target=serve_agent, args=(agents, url), kwargs={"log": [].append})
        serving.start()
        connected, _ = server.accept()
        with connected:
            hub = RawHub(connected)
            for session in SESSIONS:
                hello = hub.hear(Kind.HELLO)
                hub.say(Message(Kind.WELCOME, session, hello.seq, (1, False, 10.0, 10.0, 10_000)))
            hub.say(Message(Kind.AGENT_MESSAGE, SESSIONS[0], 1))
            hub.hear(Kind.AGENT_MESSAGE)
            for seq in (2, 3):  # the first step of each is answered by itself
                steps = [Message(Kind.AGENT_STEP, name, seq, (1.0,), OBSERVATION.body) for name in SESSIONS]
                hub.say(*steps)
                heard = [hub.hear(Kind.AGENT_STEP) for _ in SESSIONS]
                assert {(message.session, message.seq) for message in heard} == {(n, seq) for n in SESSIONS}
            hub.say(Message(Kind.GOODBYE, SESSIONS[0], 0, ("enough",)))
        serving.join()
    assert sum(numbers) >= len(SESSIONS)
    assert len(numbers) <= len(SESSIONS) / 3, numbers
