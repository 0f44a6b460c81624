"""The kit as the hub of one client: connections, greetings, and exchanges of messages.

For a player an exchange is a call and its answer; for an experiment, the reply to a request and the next one.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence, Set
from contextlib import suppress
from itertools import cycle
from typing import Any, Final, NamedTuple, TypeVar

import numpy as np

from glue.batches import Ragged, pack_actions, read_batch_task_spec
from glue.client.bodies import READ, write
from glue.conform.clients import mirror
from glue.conform.clients.connection import Connection, Gone, Listener
from glue.conform.clients.mirror import MirrorAgent, MirrorEnvironment
from glue.conform.clients.process import Client, Start
from glue.conform.messages import described, difference, same
from glue.conform.rules import Broken, NotJudged
from glue.engine.calls import role_calls
from glue.errors import GlueError, RemoteProtocolError
from glue.system import chance, clock
from glue.taskspec import parse_task_spec
from glue.types import Action, Observation
from glue.wire import zmtp
from glue.wire.codec import FROM_HUB, TO_HUB, UnknownKind, decode, encode
from glue.wire.messages import BESIDE, CALLS, PLAYERS, PROTOCOL_VERSION, ErrorCode, Kind, Message, Role, Value

MAX_BODY: Final = 2**20
"""Bytes of the largest body that the kit accepts, as its WELCOME says."""

BEAT: Final = encode(Message(Kind.HEARTBEAT, "", 0), FROM_HUB)
"""A HEARTBEAT of the kit's."""

QUIET: Final = 0.25
"""Default seconds of silence after which no message is expected: a wrong message would come at once."""

_T = TypeVar("_T")


class Exchange(NamedTuple):
    """The frames that the kit sends, and the message expected in return."""

    frames: tuple[bytes, ...]
    expected: Message


class Harness(ABC):
    """The kit's side of a client's session.

    Args:
        role: the client's role.
        start: starts a client.
        listener: the kit's listening socket.
        mirror: the client is the mirror of docs/clients.md, whatever its name.
        wait: timeout of each expected message, in seconds.
        quiet: seconds of silence after which no message is expected any more.
    """

    def __init__(
        self, role: Role, start: Start, listener: Listener, mirror: bool, wait: float, quiet: float
    ) -> None:
        self.role = role
        self.listener = listener
        self.wait = wait
        self.quiet = quiet
        self.session: str = ""
        self.hellos: int = 0  # since the last one that was asked for
        self.instance: bytes = b""  # of the last HELLO
        self.capabilities: tuple[Value, ...] = ()
        self.mirror: bool = mirror or role is Role.EXPERIMENT  # or once HELLO has the mirror's name
        self._start = start
        self._client: Client | None = None
        self._connection: Connection | None = None

    # --- The client -----------------------------------------------------------------------------------

    @property
    def client(self) -> Client:
        """The running client."""
        assert self._client is not None
        return self._client

    @property
    def connection(self) -> Connection:
        """The current connection."""
        assert self._connection is not None
        return self._connection

    @property
    def connected(self) -> bool:
        """Whether there is a connection, as far as is known."""
        return self._connection is not None

    def ready(self) -> None:
        """Provide a client that has been welcomed and is idle: the current one, or a new one.

        Raises:
            NotJudged: the client does not reach that state.
        """
        if self._client is not None and self._client.wait(0) is None and self.connected:
            try:
                self.settle()
            except Broken:
                self.abandon()
            else:
                return
        try:
            self.fresh()
        except Broken as broken:
            self.abandon()
            raise NotJudged(f"the client did not get as far as that: {broken}") from None

    def fresh(self, session: str | None = None) -> None:
        """Replace the client with a new one, and welcome it."""
        self.start(session)
        self.welcome(resumed=False)
        self.begin()

    def start(self, session: str | None = None, hold: float = 0.0) -> Message:
        """Replace the client with a new one in a session, by default with a new name; return its HELLO.

        `hold` as for `connect`.
        """
        self.drop()
        while (left := self.listener.accept(0)) is not None:
            left.close()  # of an earlier client
        self.session = f"conform-{chance.random_bytes(4).hex()}" if session is None else session
        self._client = self._start(self.listener.url, self.session)
        return self.connect(hold)

    def abandon(self) -> None:
        """Kill the client, whose state is unknown."""
        self.cut()
        self.drop()

    def drop(self) -> None:
        """End the client, with GOODBYE if it is connected."""
        if self._client is None:
            return
        if self._connection is not None:
            with suppress(Gone, Broken):
                self.connection.send(encode(Message(Kind.GOODBYE, self.session, 0, ("the end",)), FROM_HUB))
                self._client.wait(min(1.0, self.wait))
            self.cut()
        self._client.kill()
        self._client = None

    def output(self) -> str:
        """Return the output of the client."""
        return "" if self._client is None else self._client.output()

    # --- Connections ----------------------------------------------------------------------------------

    def accept(self) -> Connection:
        """Close the connection, if there is one; return the client's next, before any handshake."""
        self.cut()
        connection = self._connection = self.listener.accept(self.wait)
        if connection is None:
            code = self.client.wait(0)
            ended = "" if code is None else f": the client has ended with exit code {code}"
            raise Broken(f"a connection within {self.wait:g} s", f"none{ended}{self._said()}")
        return connection

    def connect(self, hold: float = 0.0, queued: Message | None = None) -> Message:
        """Let the client connect anew, and return its HELLO.

        Args:
            hold: seconds by which READY is delayed.
            queued: an answer that may come ahead of HELLO: libzmq queues it while there is no connection.
        """
        deadline = clock.monotonic() + self.wait
        while True:
            try:
                self.accept().greet(self.wait, hold)
                return self.hello(queued)
            except Gone:
                # libzmq sometimes gives a connection up before its greeting, and makes another.
                if clock.monotonic() > deadline:
                    raise Broken("a connection that lasts", "several that the client ended") from None

    def hello(self, queued: Message | None = None) -> Message:
        """Return the next message, which must be a HELLO; `queued` as for `connect`."""
        self.hellos = 0
        hello, frames = self.next("HELLO")
        if queued is not None and self._agrees(queued, hello):
            hello, frames = self.next("HELLO")
        if hello.kind is not Kind.HELLO or hello.session != self.session:
            raise Broken(f"HELLO in session {self.session!r}", described(hello), frames)
        return self._greeted(hello)

    def welcome(
        self,
        resumed: bool = True,
        heartbeat: float = 1.0,
        max_body: int = MAX_BODY,
        seq: int | None = None,
        carries: Set[str] | None = BESIDE,
    ) -> None:
        """Answer the HELLO, as a hub that `carries` these beside an observation; None: as an older hub."""
        named = self._hello.seq if seq is None else seq
        offered = BESIDE.intersection(self.capabilities)
        confirmed = () if carries is None or not offered else (tuple(sorted(offered & carries)),)
        scalars = PROTOCOL_VERSION, resumed, heartbeat, max(5.0, self.wait), max_body, *confirmed
        self.send(Kind.WELCOME, *scalars, seq=named)

    def reconnect(self, queued: Message | None = None) -> None:
        """Let the client connect anew, and resume the session; `queued` as for `connect`."""
        self.connect(queued=queued)
        self.welcome()
        self.resume()

    def greet_again(self) -> None:
        """Let the client greet the kit again over the same connection, as if it had been forgotten."""
        self.send(Kind.ERROR, ErrorCode.UNKNOWN_PEER, "say HELLO", seq=0)
        self.hello()
        self.welcome()
        self.resume()

    def cut(self, reset: bool = False) -> None:
        """Close the connection, if there is one."""
        if self._connection is not None:
            self._connection.close(reset)
            self._connection = None

    # --- Messages -------------------------------------------------------------------------------------

    def send(self, kind: Kind, *scalars: Value, seq: int = 0, body: bytes = b"") -> None:
        """Send a message in the session."""
        self.send_frames(encode(Message(kind, self.session, seq, scalars, body), FROM_HUB))

    def send_frames(self, frames: Sequence[bytes]) -> None:
        """Send any frames as a message."""
        self.send_bytes(zmtp.encode(frames))

    def send_bytes(self, data: bytes) -> None:
        """Send bytes over the connection."""
        self.kept(lambda: self.connection.send_bytes(data))

    def kept(self, action: Callable[[], _T]) -> _T:
        """Return the result of `action`, during which the client must not close its connection."""
        try:
            return action()
        except Gone:
            self.cut()
            code = self.client.wait(self.quiet)
            ended = "" if code is None else f" and of the client, with exit code {code}"
            raise Broken("an open connection", f"the end of the connection{ended}{self._said()}") from None

    def next(self, expected: str) -> tuple[Message, Sequence[bytes]]:
        """Return the client's next message and its frames.

        HEARTBEAT and a repeated HELLO are answered. A NOTICE says why an answer takes long; it is ignored.
        """
        deadline = clock.monotonic() + self.wait
        while True:
            frames = self.kept(lambda: self.connection.receive(max(0.0, deadline - clock.monotonic())))
            if frames is None:
                raise Broken(expected, f"nothing in {self.wait:g} s{self._said()}")
            message = self.decoded(frames, expected)
            if message.kind is Kind.HEARTBEAT:
                self.send_frames(encode(message, FROM_HUB))
            elif message.kind is Kind.NOTICE:
                continue
            elif message.kind is Kind.HELLO and self.hellos:
                self._greeted(message)
                self.welcome()
            else:
                return message, frames

    def expect(self, expected: str, fits: Callable[[Message], bool]) -> Message:
        """Return the client's next message, which must fit."""
        got, frames = self.next(expected)
        if not fits(got):
            raise Broken(expected, described(got), frames)
        return got

    def decoded(self, frames: Sequence[bytes], expected: str = "a message") -> Message:
        """Return the message in the client's frames."""
        try:
            return decode(frames, TO_HUB)
        except UnknownKind as error:
            raise Broken(expected, f"a message that no peer sends: {error}", frames) from None
        except RemoteProtocolError as error:
            raise Broken(expected, f"a malformed message: {error}", frames) from None

    def heard(self, seconds: float | None = None) -> Sequence[bytes] | None:
        """Return the frames of the next message except HEARTBEAT and NOTICE; None if none comes in time.

        Args:
            seconds: the time to wait, by default `quiet`.

        Raises:
            Gone: the client ended the connection.
        """
        deadline = clock.monotonic() + (self.quiet if seconds is None else seconds)
        while (frames := self.connection.receive(max(0.0, deadline - clock.monotonic()))) is not None:
            if self.decoded(frames).kind not in (Kind.HEARTBEAT, Kind.NOTICE):
                break
        return frames

    def nothing(self, why: str, seconds: float | None = None) -> None:
        """Expect no message except HEARTBEATs for a while, by default for `quiet` seconds."""
        frames = self.kept(lambda: self.heard(seconds))
        if frames is not None:
            raise Broken(f"nothing {why}", described(self.decoded(frames)), frames)

    def nothing_but_hello(self) -> None:
        """Expect nothing between HELLO and WELCOME except another HELLO, which is merely redundant."""
        while (frames := self.kept(self.heard)) is not None:
            message = self.decoded(frames)
            if message.kind is not Kind.HELLO:
                raise Broken("nothing between HELLO and WELCOME", described(message), frames)
            self._greeted(message)

    def take(self, expected: Message) -> Sequence[bytes]:
        """Receive the next message, which must be as expected; return its frames."""
        got, frames = self.next(described(expected))
        self.matches(expected, got, frames)
        return frames

    def run(self, exchange: Exchange) -> Sequence[bytes]:
        """Carry out an exchange; return the frames received."""
        self.send_frames(exchange.frames)
        return self.take(exchange.expected)

    def matches(self, expected: Message, got: Message, frames: Sequence[bytes]) -> None:
        """Check that a message is as expected, then record it."""
        if not self._agrees(expected, got):
            wanted = self.numbered(expected, got)
            raise Broken(described(wanted), f"{described(got)}{difference(wanted, frames)}", frames)
        self.took(got)

    def _agrees(self, expected: Message, got: Message) -> bool:
        wanted = self.numbered(expected, got)
        # Without the mirror the content of an answer is unknown; `decoded` has checked its form.
        return same(wanted, got) if self.mirror else wanted[:3] == got[:3]

    # --- Exchanges ------------------------------------------------------------------------------------

    @abstractmethod
    def begin(self) -> None:
        """Continue from the first WELCOME to the first exchange."""

    @abstractmethod
    def settle(self) -> None:
        """Complete the exchanges that have begun."""

    @abstractmethod
    def exchanges(self) -> int:
        """Return the number of exchanges of an episode, with init and cleanup."""

    @abstractmethod
    def with_body(self) -> Exchange:
        """Return an exchange whose frames carry an abstract type."""

    @abstractmethod
    def prepare(self) -> Exchange:
        """Return the next exchange of an episode; the caller has to carry it out."""

    @abstractmethod
    def resume(self) -> None:
        """Receive the messages that the client sends as soon as it is welcomed over a new connection."""

    @abstractmethod
    def repeat(self, exchange: Exchange, frames: Sequence[bytes]) -> None:
        """Repeat an exchange after a new WELCOME, as if the client's message, `frames`, had been lost."""

    def numbered(self, expected: Message, got: Message) -> Message:
        """Return the expected message with the sequence number that it must have."""
        return expected

    @abstractmethod
    def took(self, message: Message) -> None:
        """Record an expected message."""

    def exchange(self) -> None:
        """Carry out the next exchange."""
        self.run(self.prepare())

    def episode(self) -> None:
        """Carry out all exchanges of an episode."""
        for _ in range(self.exchanges()):
            self.exchange()

    def _greeted(self, hello: Message) -> Message:
        self._hello = hello
        self.hellos += 1
        scalars: Any = hello.scalars
        _, _, self.instance, name, _, self.capabilities = scalars
        self.mirror = self.mirror or name == mirror.NAME
        return hello

    def _said(self) -> str:
        lines = self.output().strip().splitlines()
        return f"; it printed: {lines[-1]:.200}" if lines else ""


_KINDS: Final = {
    role: {kind.name.partition("_")[2]: kind for kind, call in CALLS.items() if call.callee is role}
    for role in PLAYERS
}

SPEC: Final = "a task for a mirror, größer als nötig".encode()
"""The mirror's task: not a task spec, so that any answer is legal."""

TASK: Final = (
    b"VERSION RL-Glue-3.0 PROBLEMTYPE episodic DISCOUNTFACTOR 1.0 OBSERVATIONS INTS (0 20) "
    b"ACTIONS INTS (0 1) REWARDS (-1.0 1.0)"
)
"""The task of any other agent: one int, which the kit shows as 0."""

SHOWN: Final = Observation([0], chars=b"ab")
"""An observation that even a client that confuses numbers understands: every number is zero."""


class PlayerHarness(Harness):
    """The kit as the hub of an agent or environment.

    The expected answers are those of our own mirror, `glue.testing.mirror`. Any other player is only given
    calls that are legal in its task, and may give any answer to them.
    """

    seq: int = 0

    _action = Action().body

    @property
    def kinds(self) -> dict[str, Kind]:
        """The calls to the client by their names without its role: AGENT_STEP is `STEP`."""
        return _KINDS[self.role]

    def begin(self) -> None:
        model: Any = MirrorAgent() if self.role is Role.AGENT else MirrorEnvironment()
        self._handlers = role_calls(self.role, model)
        self.seq = 0
        self._plot: Iterator[tuple[str, tuple[Value, ...], bytes]] = cycle(self._episode())

    def _episode(self) -> list[tuple[str, tuple[Value, ...], bytes]]:
        if self.role is Role.AGENT:
            spec, shown = (SPEC, SHOWN.body) if self.mirror else (TASK, Observation([0]).body)
            return [
                ("INIT", (), spec),
                ("START", (), shown),
                ("STEP", (0.0,), shown),
                ("MESSAGE", (), b"how are you?"),
                ("STEP", (0.0,), shown),
                ("END", (0.0,), b""),
                ("START", (), shown),
                ("CLEANUP", (), b""),
            ]
        return [
            ("INIT", (), b""),
            ("START", (), b""),
            ("STEP", (), SHOWN.body),
            ("MESSAGE", (), b"how are you?"),
            ("STEP", (), Observation([0], chars=b"c").body),
            ("START", (), b""),
            ("CLEANUP", (), b""),
        ]

    def exchanges(self) -> int:
        return len(self._episode())

    def prepare(self) -> Exchange:
        name, scalars, body = next(self._plot)
        if name == "STEP" and self.role is Role.ENVIRONMENT and not self.mirror:
            body = self._action
        return self.call(name, *scalars, body=body)

    def with_body(self) -> Exchange:
        name = "START" if self.role is Role.AGENT else "STEP"
        while (exchange := self.prepare()).expected.kind is not self.kinds[name]:
            self.run(exchange)
        return exchange

    def call(self, name: str, *scalars: Value, body: bytes = b"", seq: int | None = None) -> Exchange:
        """Return a call, by default with the next number, and the expected answer."""
        self.seq = self.seq + 1 if seq is None else seq
        kind = self.kinds[name]
        asked = Message(kind, self.session, self.seq, scalars, body)
        answer = Message(kind, self.session, self.seq)
        if self.mirror:
            values, result = self._handlers[kind](scalars, READ[CALLS[kind].request.body](body))
            answer = answer._replace(scalars=values, body=write(result))
        return Exchange(encode(asked, FROM_HUB), answer)

    def ask(self, name: str, *scalars: Value, body: bytes = b"", seq: int | None = None) -> Sequence[bytes]:
        """Call, and expect the answer; return its frames."""
        return self.run(self.call(name, *scalars, body=body, seq=seq))

    def step(self, shown: Observation | Action, reward: float = 0.0) -> Exchange:
        """Return a step that shows `shown` to the mirror; other players get a message, legal at any time."""
        if not self.mirror:
            return self.call("MESSAGE", body=shown.chars)
        scalars = (reward,) if self.role is Role.AGENT else ()
        return self.call("STEP", *scalars, body=shown.body)

    def steps(self, *all_shown: Observation | Action) -> None:
        """Carry out a step with each of `all_shown`."""
        for each in all_shown:
            self.run(self.step(each))

    def settle(self) -> None:
        """Do nothing: an exchange is complete with its answer."""

    def resume(self) -> None:
        """Do nothing: a player waits for the next call."""

    def repeat(self, exchange: Exchange, frames: Sequence[bytes]) -> None:
        again = self.run(exchange)
        if list(again) != list(frames):
            raise Broken("the same bytes as the first time", described(self.decoded(again)), again)

    def took(self, message: Message) -> None:
        """Keep a legal action for an environment that is not the mirror."""
        if message.kind is not Kind.ENV_INIT or self.mirror:
            return
        generator = np.random.default_rng(0)
        # Without legal actions in its task spec, the empty action is as good as any.
        with suppress(GlueError, UnicodeDecodeError):
            if "batch" in self.capabilities:
                games, task_spec = read_batch_task_spec(message.body.decode())
                actions = parse_task_spec(task_spec).actions
                chosen = [Action(*actions.sample(generator)) for _ in range(games)]
                self._action = pack_actions(Ragged.of(chosen)).body
            else:
                self._action = Action(*parse_task_spec(message.body.decode()).actions.sample(generator)).body
