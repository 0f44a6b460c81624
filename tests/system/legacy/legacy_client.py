"""A client of the original RL-Glue 3.x for tests, with plain sockets and struct.

It shares no code with `glue.legacy`, so that each tests the other. It behaves like the original
clients, including the quirks that a server must tolerate; `STYLES` lists them.

Source: the wire protocol of RL-Glue core 3.04 and of the C, Java, Python and Lisp codecs.
"""

from __future__ import annotations

import select
import socket
import struct
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import IntEnum
from typing import Any

from glue import Action, Agent, Environment, Experiment, Observation
from glue.types import AbstractType
from glue.wire.messages import Kind, Value

TIMEOUT = 30.0
"""Seconds that a test waits for the other side before it fails."""


class Id(IntEnum):
    """The message ids of the original."""

    EXPERIMENT_CONNECTION = 1
    AGENT_CONNECTION = 2
    ENVIRONMENT_CONNECTION = 3
    AGENT_INIT = 4
    AGENT_START = 5
    AGENT_STEP = 6
    AGENT_END = 7
    AGENT_CLEANUP = 8
    AGENT_MESSAGE = 10
    ENV_INIT = 11
    ENV_START = 12
    ENV_STEP = 13
    ENV_CLEANUP = 14
    ENV_MESSAGE = 19
    RL_INIT = 20
    RL_START = 21
    RL_STEP = 22
    RL_CLEANUP = 23
    RL_RETURN = 24
    RL_NUM_STEPS = 25
    RL_NUM_EPISODES = 26
    RL_EPISODE = 27
    RL_AGENT_MESSAGE = 33
    RL_ENV_MESSAGE = 34
    RL_TERM = 35
    RL_ENV_START = 36
    RL_ENV_STEP = 37
    RL_AGENT_START = 38
    RL_AGENT_STEP = 39
    RL_AGENT_END = 40


@dataclass(frozen=True)
class Style:
    """The behaviour of a codec on the wire.

    Attributes:
        split: header and payload are sent separately.
        nodelay: TCP_NODELAY is set.
        greedy: reads all that is available, uses the first frame and discards the rest.
        utf16_counts: counts a text in UTF-16 units although it sends UTF-8.
        farewell: answer to the server's last message: "echo", "repeat" or "nothing".
        byte_at_a_time: sends every byte separately.
    """

    split: bool = False
    nodelay: bool = True
    greedy: bool = False
    utf16_counts: bool = False
    farewell: str = "echo"
    byte_at_a_time: bool = False


STYLES = {
    "c": Style(split=True),
    "java": Style(nodelay=False, greedy=True, utf16_counts=True, farewell="repeat"),
    "python": Style(farewell="repeat"),
    "lisp": Style(farewell="nothing"),
    "drip": Style(byte_at_a_time=True),
}


def pack(value: AbstractType) -> bytes:
    """Return the bytes of an abstract type."""
    ints, doubles, chars = value.ints.tolist(), value.doubles.tolist(), value.chars
    form = f">3I{len(ints)}i{len(doubles)}d"
    return struct.pack(form, len(ints), len(doubles), len(chars), *ints, *doubles) + chars


def unpack(payload: bytes, offset: int = 0) -> tuple[Observation, int]:
    """Return the abstract type at `offset`, as an observation, and the offset after it."""
    ints, doubles, chars = struct.unpack_from(">3I", payload, offset)
    numbers = struct.unpack_from(f">{ints}i{doubles}d", payload, offset + 12)
    at_chars = offset + 12 + 4 * ints + 8 * doubles
    end = at_chars + chars
    return Observation(numbers[:ints], numbers[ints:], payload[at_chars:end]), end


def as_action(value: AbstractType) -> Action:
    """Return an abstract type as an action."""
    return Action(value.ints, value.doubles, value.chars)


def unpack_text(payload: bytes) -> str:
    """Return the text that a payload consists of."""
    (count,) = struct.unpack_from(">I", payload)
    return payload[4 : 4 + count].decode("utf-8", "surrogateescape")


class Closed(Exception):
    """The server closed the connection."""


class Connection:
    """One TCP connection to the server, in the style of one codec; waits `timeout` seconds for each frame."""

    def __init__(self, port: int, style: Style = STYLES["c"], timeout: float = TIMEOUT) -> None:
        self.style = style
        self._received = b""
        self._last_sent = b""
        self._socket = socket.create_connection(("127.0.0.1", port), timeout)
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, style.nodelay)

    def send(self, message_id: int, payload: bytes = b"") -> None:
        """Send one frame."""
        self._send(struct.pack(">iI", message_id, len(payload)), payload)

    def send_text(self, message_id: int, text: str | None) -> None:
        """Send a frame that holds one text; None is sent as the empty text."""
        encoded = (text or "").encode("utf-8", "surrogateescape")
        count = len((text or "").encode("utf-16-be")) // 2 if self.style.utf16_counts else len(encoded)
        self._send(struct.pack(">iI", message_id, 4 + count), struct.pack(">I", count) + encoded)

    def _send(self, header: bytes, payload: bytes) -> None:
        self._last_sent = header + payload
        if self.style.byte_at_a_time:
            for byte in self._last_sent:
                self.send_raw(bytes([byte]))
        elif self.style.split and payload:
            self.send_raw(header)
            self.send_raw(payload)
        else:
            self.send_raw(self._last_sent)

    def send_raw(self, data: bytes) -> None:
        """Send bytes that need not be a frame."""
        self._socket.sendall(data)

    def flood(self, data: bytes) -> int:
        """Send as much of `data` as can be sent without waiting; return the number of bytes."""
        sent = 0
        with memoryview(data) as view:
            while sent < len(data) and select.select([], [self._socket], [], 0)[1]:
                sent += self._socket.send(view[sent : sent + 65536])
        return sent

    def farewell(self) -> None:
        """Answer the server's last message, if this codec does so; the server may be gone already."""
        try:
            if self.style.farewell == "echo":
                self.send(Id.RL_TERM)
            elif self.style.farewell == "repeat":
                self.send_raw(self._last_sent)
        except OSError:
            pass

    def receive(self) -> tuple[int, bytes]:
        """Return the id and payload of the next frame.

        Raises:
            Closed: the server closed the connection.
        """
        self._fill(8)
        message_id, size = struct.unpack_from(">iI", self._received)
        self._fill(8 + size)
        payload = self._received[8 : 8 + size]
        self._received = b"" if self.style.greedy else self._received[8 + size :]
        return message_id, payload

    def _fill(self, size: int) -> None:
        while len(self._received) < size:
            missing = size - len(self._received)
            chunk = self._socket.recv(max(missing, 65536) if self.style.greedy else missing)
            if not chunk:
                raise Closed
            self._received += chunk

    def nothing_received(self) -> bool:
        """Return whether there is nothing to receive, not even the end."""
        return not self._received and not select.select([self._socket], [], [], 0)[0]

    def receive_until_closed(self) -> bytes:
        """Return everything received until the server closes the connection."""
        data = self._received
        while chunk := self._socket.recv(65536):
            data += chunk
        return data

    def close_writing(self) -> None:
        """Close the sending half; bytes can still be received."""
        self._socket.shutdown(socket.SHUT_WR)

    def close(self) -> None:
        """Close in the usual way."""
        self._socket.close()

    def reset(self) -> None:
        """Close so that the server sees a reset, as after a crash with unread data."""
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
        self._socket.close()


Answers = Mapping[int, Callable[[bytes], bytes | str | None]]
"""A player's answer to each message of the server: a payload, or a text that is still to be packed."""


class Die(Exception):
    """Raised by a program to have its connection reset instead of an answer sent."""


def play(player: Agent | Environment, connection: Connection) -> None:
    """Join, and let one of our players answer the server until it says goodbye, or until the player dies.

    Raises:
        Closed: the server closed the connection without a goodbye.
    """
    if isinstance(player, Agent):
        answers = _answers_of_agent(player)
        connection.send(Id.AGENT_CONNECTION)
    else:
        answers = _answers_of_environment(player)
        connection.send(Id.ENVIRONMENT_CONNECTION)
    try:
        while True:
            message_id, payload = connection.receive()
            if message_id == Id.RL_TERM:
                assert payload == b""
                connection.farewell()
                break
            answer = answers[message_id](payload)
            if message_id in (Id.ENV_INIT, Id.ENV_MESSAGE, Id.AGENT_MESSAGE):
                assert not isinstance(answer, bytes)
                connection.send_text(message_id, answer)
            else:
                assert not isinstance(answer, str)
                connection.send(message_id, answer or b"")
    except Die:
        connection.reset()
    finally:
        connection.close()


def _answers_of_agent(agent: Agent) -> Answers:
    return {
        Id.AGENT_INIT: lambda payload: agent.agent_init(unpack_text(payload)),
        Id.AGENT_START: lambda payload: pack(agent.agent_start(unpack(payload)[0])),
        Id.AGENT_STEP: lambda payload: pack(
            agent.agent_step(struct.unpack_from(">d", payload)[0], unpack(payload, 8)[0])
        ),
        Id.AGENT_END: lambda payload: agent.agent_end(*struct.unpack(">d", payload)),
        Id.AGENT_CLEANUP: lambda payload: agent.agent_cleanup(),
        Id.AGENT_MESSAGE: lambda payload: agent.agent_message(unpack_text(payload)),
    }


def _answers_of_environment(environment: Environment) -> Answers:
    def step(payload: bytes) -> bytes:
        reward, observation, terminal, *_ = environment.env_step(as_action(unpack(payload)[0]))
        return struct.pack(">id", terminal, reward) + pack(observation)

    return {
        Id.ENV_INIT: lambda payload: environment.env_init(),
        Id.ENV_START: lambda payload: pack(environment.env_start()),
        Id.ENV_STEP: step,
        Id.ENV_CLEANUP: lambda payload: environment.env_cleanup(),
        Id.ENV_MESSAGE: lambda payload: environment.env_message(unpack_text(payload)),
    }


_SENT = {Id.RL_EPISODE: ">I", Id.RL_AGENT_STEP: ">d", Id.RL_AGENT_END: ">d"}
_RECEIVED = {
    **dict.fromkeys((Id.RL_STEP, Id.RL_ENV_STEP), ">id"),
    **dict.fromkeys((Id.RL_EPISODE, Id.RL_NUM_STEPS, Id.RL_NUM_EPISODES), ">i"),
    Id.RL_RETURN: ">d",
}
_TEXTS = (Id.RL_INIT, Id.RL_AGENT_MESSAGE, Id.RL_ENV_MESSAGE)


class OriginalExperiment(Experiment):
    """Our verbs over the connection of an original experiment, which sends no seed."""

    def __init__(self, connection: Connection) -> None:
        self.connection = connection
        connection.send(Id.EXPERIMENT_CONNECTION)

    def close(self) -> None:
        """Leave without a goodbye, as the original experiments do."""
        self.connection.close()

    def _call(self, kind: Kind, scalars: tuple[Value, ...] = (), body: Any = None) -> tuple[Any, Any]:
        asked = Id[kind.name]
        if isinstance(body, str):
            self.connection.send_text(asked, body)
        else:
            numbers = b"" if asked is Id.RL_INIT else struct.pack(_SENT.get(asked, ">"), *scalars)
            self.connection.send(asked, numbers + (b"" if body is None else pack(body)))
        answered, payload = self.connection.receive()
        assert answered == asked, f"{asked!r} was asked, {answered} answered"
        if asked in _TEXTS:
            return (), unpack_text(payload)
        form = _RECEIVED.get(asked, ">")
        at, values = struct.calcsize(form), struct.unpack_from(form, payload)[::-1]
        shown: list[AbstractType] = []
        while at < len(payload):
            value, at = unpack(payload, at)
            shown.append(value)
        if shown and asked not in (Id.RL_ENV_START, Id.RL_ENV_STEP):
            shown[-1] = as_action(shown[-1])
        return values, shown if len(shown) > 1 else shown[0] if shown else None
