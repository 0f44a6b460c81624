"""The kit as a hub, with one client: connections, greetings, and exchanges of one message for another.

For a player an exchange is a call and its answer; for an experiment, the reply to a request and the next one.
"""

from __future__ import annotations

import secrets
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from typing import Final, NamedTuple, TypeVar

from glue.errors import RemoteProtocolError
from glue.protocol import zmtp
from glue.protocol.messages import PROTOCOL_VERSION, Kind, Message, Role, Value
from glue.protocol.wire import FROM_HUB, TO_HUB, UnknownKind, decode, encode
from glue.testing.conform.hub.clients import Client, Start
from glue.testing.conform.hub.comparing import described, difference, same
from glue.testing.conform.hub.rules import Broken, NotJudged
from glue.testing.conform.hub.wire import Gone, Listener, Wire

__all__ = ["LULL", "MAX_BODY", "Desk", "Exchange"]

MAX_BODY: Final = 2**20
"""Bytes of the largest body that the kit accepts, and says so in WELCOME."""

LULL: Final = 0.25
"""Seconds in which nothing is to come, where something would come at once."""

_LOOK: Final = 0.02
"""Seconds for a look at each of two things that may happen."""

_T = TypeVar("_T")


class Exchange(NamedTuple):
    """What the kit sends, and the message that is to come for it."""

    frames: tuple[bytes, ...]
    expected: Message


class Desk(ABC):
    """The kit's side of a client's session.

    Args:
        role: the client's.
        start: starts it.
        listener: where it finds the kit.
        wait: seconds in which whatever is to come must come.
    """

    def __init__(self, role: Role, start: Start, listener: Listener, wait: float) -> None:
        self.role = role
        self.listener = listener
        self.wait = wait
        self.session = ""
        self.hellos = 0  # over the connection that there is
        self.instances: list[bytes] = []  # of each program that was started
        self.instance = b""  # of the last HELLO
        self.capabilities: tuple[Value, ...] = ()
        self._start = start
        self._client: Client | None = None
        self._wire: Wire | None = None

    # --- The client -----------------------------------------------------------------------------------

    @property
    def client(self) -> Client:
        """The client that runs."""
        assert self._client is not None
        return self._client

    @property
    def wire(self) -> Wire:
        """The connection that there is."""
        assert self._wire is not None
        return self._wire

    @property
    def connected(self) -> bool:
        """Whether there is a connection, as far as the kit has noticed."""
        return self._wire is not None

    def ready(self) -> None:
        """Have a client that is welcomed and waits: the one that is there, or a new one.

        Raises:
            NotJudged: it does not come so far.
        """
        if self._client is not None and self._client.wait(0) is None and self.connected:
            try:
                self.settle()
            except Broken:
                self.abandon()
            else:
                return
        self.drop()
        try:
            self.start()
            self.connect()
            self.welcome(resumed=False)
            self.begin()
        except Broken as broken:
            self.abandon()
            raise NotJudged(f"the client did not get as far as that: {broken}") from None

    def start(self) -> None:
        """Start a client, in a session of its own."""
        while (left := self.listener.accept(0)) is not None:
            left.close()  # of a client before
        self.session = f"conform-{secrets.token_hex(4)}"
        self._client = self._start(self.listener.url, self.session)

    def abandon(self) -> None:
        """End the client at once: nothing is known of what it thinks."""
        self.cut()
        self.drop()

    def drop(self) -> None:
        """End the client, with a goodbye if it listens."""
        if self._client is None:
            return
        if self._wire is not None:
            try:
                self.wire.send(encode(Message(Kind.GOODBYE, self.session, 0, ("the end",)), FROM_HUB))
                self._client.wait(min(1.0, self.wait))
            except (Gone, Broken):
                pass
            self.cut()
        self._client.kill()
        self._client = None

    def output(self) -> str:
        """Return what the client has printed."""
        return "" if self._client is None else self._client.output()

    # --- Connections ----------------------------------------------------------------------------------

    def accept(self) -> Wire:
        """Return the client's next connection, before any handshake."""
        wire = self.listener.accept(self.wait)
        if wire is None:
            code = self.client.wait(0)
            ended = "" if code is None else f": the client has ended with exit code {code}"
            raise Broken(f"a connection within {self.wait:g} s", f"none{ended}{self._said()}")
        return wire

    def connect(self, hold: float = 0.0) -> Message:
        """Accept a connection, and return the HELLO over it; READY is held back for `hold` seconds."""
        self.cut()
        deadline = time.monotonic() + self.wait
        self._wire = self.accept()
        while True:
            try:
                self.wire.greet(self.wait, hold)
                break
            except Gone:
                # libzmq sometimes gives a connection up before its greeting, and makes another.
                if time.monotonic() > deadline:
                    raise Broken("a connection that lasts", "several that the client ended") from None
                self.cut()
                self._wire = self.accept()
        self.hellos = 0
        hello, frames = self.next("HELLO")
        if hello.kind is not Kind.HELLO or hello.session != self.session:
            raise Broken(f"HELLO in session {self.session!r}", described(hello), frames)
        return self._greeted(hello)

    def welcome(
        self, resumed: bool = True, heartbeat: float = 1.0, max_body: int = MAX_BODY, seq: int | None = None
    ) -> None:
        """Answer the HELLO."""
        named = self._hello.seq if seq is None else seq
        timeout = max(5.0, self.wait)
        self.send(Kind.WELCOME, PROTOCOL_VERSION, resumed, heartbeat, timeout, max_body, seq=named)

    def returns(self) -> int | None:
        """Let a client come back, or end: return its exit code, None if it has come back."""
        deadline = time.monotonic() + self.wait
        while time.monotonic() < deadline:
            code = self.client.wait(_LOOK)
            if code is not None:
                return code
            if self.listener.waits(_LOOK):
                self.reconnect()
                return None
        raise Broken(f"the client's return or end within {self.wait:g} s", "neither")

    def adopt(self, wire: Wire) -> None:
        """Take a connection as the one that there is."""
        self._wire = wire

    def greeted_again(self) -> None:
        """Expect another HELLO over the same connection, and answer it."""
        hello, frames = self.next("HELLO", again=True)
        if hello.kind is not Kind.HELLO:
            raise Broken("HELLO over the same connection", described(hello), frames)
        self.welcome()

    def cut(self, reset: bool = False) -> None:
        """End the connection, if there is one."""
        if self._wire is not None:
            self._wire.close(reset)
            self._wire = None

    def reconnect(self) -> None:
        """Have the client come back over a new connection, and go on."""
        self.connect()
        self.welcome()
        self.resume()

    # --- Messages -------------------------------------------------------------------------------------

    def send(self, kind: Kind, *scalars: Value, seq: int = 0, body: bytes = b"") -> None:
        """Send a message of the session."""
        self.send_frames(encode(Message(kind, self.session, seq, scalars, body), FROM_HUB))

    def send_frames(self, frames: Sequence[bytes]) -> None:
        """Send a message, whatever it is."""
        self.send_bytes(zmtp.encode(frames))

    def send_bytes(self, data: bytes) -> None:
        """Send bytes over the connection."""
        self.kept(lambda: self.wire.send_bytes(data))

    def kept(self, action: Callable[[], _T]) -> _T:
        """Return what `action` does; the client must not end its connection meanwhile."""
        try:
            return action()
        except Gone:
            self.cut()
            code = self.client.wait(LULL)
            ended = "" if code is None else f" and itself, with exit code {code}"
            raise Broken(
                "that the client keeps its connection", f"the end of it{ended}{self._said()}"
            ) from None

    def next(self, expected: str, again: bool = False) -> tuple[Message, Sequence[bytes]]:
        """Return the client's next message and its frames.

        HEARTBEAT and a repeated HELLO are answered, but for one that is to come `again`.
        """
        deadline = time.monotonic() + self.wait
        while True:
            frames = self.kept(lambda: self.wire.receive(max(0.0, deadline - time.monotonic())))
            if frames is None:
                raise Broken(expected, f"nothing in {self.wait:g} s{self._said()}")
            message = self.decoded(frames, expected)
            if message.kind is Kind.HEARTBEAT:
                self.send_frames(encode(message, FROM_HUB))
            elif message.kind is Kind.HELLO and self.hellos:
                self._greeted(message)
                if again:
                    return message, frames
                self.welcome()
            else:
                return message, frames

    def decoded(self, frames: Sequence[bytes], expected: str = "a message") -> Message:
        """Return the message that frames of the client hold."""
        try:
            return decode(frames, TO_HUB)
        except UnknownKind as error:
            raise Broken(expected, f"what a peer does not send: {error}", frames) from None
        except RemoteProtocolError as error:
            raise Broken(expected, f"what is no message: {error}", frames) from None

    def nothing(self, why: str, seconds: float = LULL) -> None:
        """Expect that the client says nothing for a while, but for HEARTBEATs."""
        deadline = time.monotonic() + seconds
        while True:
            frames = self.kept(lambda: self.wire.receive(max(0.0, deadline - time.monotonic())))
            if frames is None:
                return
            message = self.decoded(frames, f"nothing {why}")
            if message.kind is not Kind.HEARTBEAT:
                raise Broken(f"nothing {why}", described(message), frames)

    def take(self, expected: Message) -> Sequence[bytes]:
        """Receive the next message, which must be as expected; return its frames."""
        got, frames = self.next(described(expected))
        self.matches(expected, got, frames)
        return frames

    def matches(self, expected: Message, got: Message, frames: Sequence[bytes]) -> None:
        """Check that a message is as expected, and note it."""
        wanted = self.numbered(expected, got)
        if not same(wanted, got):
            raise Broken(described(wanted), f"{described(got)}{difference(wanted, frames)}", frames)
        self.took(got)

    # --- Exchanges ------------------------------------------------------------------------------------

    @abstractmethod
    def begin(self) -> None:
        """Go on from the first WELCOME to where an exchange can take place."""

    @abstractmethod
    def settle(self) -> None:
        """Go through the exchanges without which no scene can begin."""

    @abstractmethod
    def exchanges(self) -> int:
        """Return how many exchanges an episode with everything around it has."""

    @abstractmethod
    def prepare(self) -> Exchange:
        """Return the next exchange of such an episode; it must take place."""

    @abstractmethod
    def resume(self) -> None:
        """Take what the client says at once when it is welcomed over a new connection."""

    @abstractmethod
    def repeat(self, exchange: Exchange, frames: Sequence[bytes]) -> None:
        """After a new WELCOME, go through an exchange again of which only the client's message was lost."""

    def numbered(self, expected: Message, got: Message) -> Message:
        """Return what is expected with the sequence number that it must have."""
        return expected

    @abstractmethod
    def took(self, message: Message) -> None:
        """Note a message that was as expected."""

    def exchange(self) -> None:
        """Go through the next exchange."""
        exchange = self.prepare()
        self.send_frames(exchange.frames)
        self.take(exchange.expected)

    def episode(self) -> None:
        """Go through all exchanges of an episode."""
        for _ in range(self.exchanges()):
            self.exchange()

    def _greeted(self, hello: Message) -> Message:
        self._hello = hello
        self.hellos += 1
        _, _, instance, _, _, capabilities = hello.scalars
        assert isinstance(instance, bytes)
        assert isinstance(capabilities, tuple)
        self.instance, self.capabilities = instance, capabilities
        return hello

    def _said(self) -> str:
        lines = self.output().strip().splitlines()
        return f"; it printed: {lines[-1]:.200}" if lines else ""
