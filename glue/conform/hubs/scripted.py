"""Scripted peers of a hub, driven message by message.

A scene is one session with an agent, an environment and an experiment. One thread drives all three, so that
the order of their messages is decided by the scene, never by chance.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from glue.client.libzmq import Context, DealerTransport
from glue.conform.messages import described
from glue.conform.rules import Broken
from glue.errors import LocalProtocolError, RemoteProtocolError
from glue.hub.sessions import INSTANCE_SIZE
from glue.system import chance, clock
from glue.types import Action, Observation
from glue.wire.codec import FROM_HUB, TO_HUB, decode, encode
from glue.wire.messages import CALLS, PROTOCOL_VERSION, ErrorCode, Event, Kind, Message, Role, Value

TASK_SPEC: Final = "a task for a hub, with ümlauts"


def saw(step: int) -> bytes:
    """Return the observation that the environment shows after `step` steps, as a body."""
    return Observation([step, -(2**31)], [step / 7], b"a\0\xff").body


def did(step: int) -> bytes:
    """Return the action with which the agent answers `saw(step)`, as a body."""
    return Action([step + 100], [-0.1]).body


def reward(step: int) -> float:
    """Return the reward of step `step`, from 1; sums of rewards are exact, and all different."""
    return (-0.5) ** step


def number(scalar: Value) -> float:
    """Return a scalar of a WELCOME as a number."""
    assert isinstance(scalar, (int, float))
    return float(scalar)


class ScriptedPeer:
    """A peer of a hub: an instance, and its connections one after the other."""

    def __init__(self, scene: Scene, role: Role, capabilities: tuple[str, ...] = ()) -> None:
        self.role = role
        self.session: str = scene.session
        self.notices: list[tuple[Value, ...]] = []
        self.seq: int = 0
        self._scene = scene
        self._instance = chance.random_bytes(INSTANCE_SIZE)
        self._capabilities = capabilities
        self._connection: DealerTransport | None = None
        self.connect()

    def connect(self) -> None:
        """Open a new connection; the old one is closed without GOODBYE."""
        self.vanish()
        self._connection = DealerTransport(self._scene.context, self._scene.url, self._scene.wait)

    def vanish(self) -> None:
        """Close the connection without GOODBYE."""
        if self._connection is not None:
            self._connection.close(0)
            self._connection = None

    def hello(self, versions: tuple[int, ...] = (PROTOCOL_VERSION,), seq: int = 0) -> None:
        """Send HELLO once connected: a hub may close a connection whose HELLO is late."""
        assert self._connection is not None
        deadline = clock.monotonic() + self._scene.wait
        self._connection.wait_at_most(self._scene.wait)
        while not self._connection.connected and clock.monotonic() < deadline:
            self._connection.receive()
        name, codec = f"a test's {self.role}", "glue.testing"
        self.send(
            Kind.HELLO, versions, str(self.role), self._instance, name, codec, self._capabilities, seq=seq
        )

    def join(self, resumed: bool = False, seq: int = 0) -> Message:
        """Send HELLO, and return the WELCOME."""
        self.hello(seq=seq)
        welcome = self.expects(Kind.WELCOME, seq)
        known = "a known" if resumed else "an unknown"
        self.check(welcome.scalars[1] is resumed, f"{described(welcome)} received for {known} instance")
        return welcome

    def rejoin(self, resumed: bool = True) -> None:
        """Join over a new connection."""
        self.connect()
        self.join(resumed)

    def send(self, kind: Kind, *scalars: Value, seq: int = 0, body: bytes = b"") -> None:
        """Send a message."""
        self.send_frames(encode(Message(kind, self.session, seq, scalars, body), TO_HUB))

    def send_frames(self, frames: Sequence[bytes]) -> None:
        """Send any frames."""
        assert self._connection is not None
        if not self._connection.send(frames):
            raise LocalProtocolError(f"nothing can be sent to {self._scene.url}")

    def ask(self, kind: Kind, *scalars: Value, body: bytes = b"") -> None:
        """Send the experiment's next request."""
        self.seq += 1
        self.send(kind, *scalars, seq=self.seq, body=body)

    def expects(
        self, kind: Kind, seq: int | None = None, wait: float | None = None, session: str | None = None
    ) -> Message:
        """Return the next message, which must be of this kind and, if one is given, this `seq`.

        HEARTBEATs are skipped, and NOTICEs kept, unless they are expected.
        """
        named = self.session if session is None else session
        expected = kind.name if seq is None else f"{kind.name} {seq}"
        deadline = clock.monotonic() + (self._scene.wait if wait is None else wait)
        while (message := self._receive(deadline)) is not None:
            if (message.kind, message.session) == (kind, named) and seq in (None, message.seq):
                return message
            if message.kind is Kind.NOTICE and message.session == self.session:
                self.notices.append(message.scalars)
            elif message.kind is not Kind.HEARTBEAT:
                where = "" if message.session == named else f" of session {message.session!r}"
                raise self.broken(f"{described(message)}{where} received instead of {expected}")
        raise self.broken(f"{expected} was not received in time")

    def expects_error(self, code: ErrorCode, seq: int, session: str | None = None) -> None:
        """Expect an ERROR of this code."""
        error = self.expects(Kind.ERROR, seq, session=session)
        self.check(error.scalars[0] == code, f"{described(error)} received instead of the error {code}")

    def expects_notice(self, event: Event, role: Role) -> None:
        """Expect a NOTICE, which may have come already."""
        while not any(notice[:2] == (event, role) for notice in self.notices):
            self.notices.append(self.expects(Kind.NOTICE).scalars)
        self.notices.clear()

    def expects_nothing(self) -> None:
        """Check by a HEARTBEAT that nothing else was sent: messages of a connection keep their order."""
        self.send(Kind.HEARTBEAT, seq=77)
        self.expects(Kind.HEARTBEAT, 77)

    def expects_call(self, kind: Kind, *scalars: Value, body: bytes = b"") -> int:
        """Expect a call with just these scalars and body; return its number."""
        call = self.expects(kind)
        wanted = call._replace(scalars=scalars, body=body)
        self.check(call == wanted, f"{described(call)} received instead of {described(wanted)}")
        self._scene.calls.append(call)
        return call.seq

    def answers(
        self,
        kind: Kind,
        *scalars: Value,
        body: bytes = b"",
        reply: tuple[Value, ...] = (),
        gives: bytes = b"",
    ) -> None:
        """Expect a call as `expects_call` does, and answer it with `reply` and the body `gives`."""
        self.send(kind, *reply, seq=self.expects_call(kind, *scalars, body=body), body=gives)

    def expects_reply(self, kind: Kind, *scalars: Value, body: bytes = b"") -> None:
        """Expect the reply to the last request, with just these scalars and body."""
        reply = self.expects(kind, self.seq)
        wanted = reply._replace(scalars=scalars, body=body)
        self.check(reply == wanted, f"{described(reply)} received instead of {described(wanted)}")

    def gets(self, kind: Kind, *scalars: Value) -> None:
        """Send a request that concerns no player, and expect a reply with these scalars."""
        self.ask(kind)
        self.expects_reply(kind, *scalars)

    def leave(self) -> None:
        """Say goodbye. Another HELLO may follow."""
        self.send(Kind.GOODBYE, "the scene is over")

    def part(self) -> None:
        """Say goodbye and close the connection, if there is one."""
        if self._connection is not None:
            self.leave()
            self._connection.close()
            self._connection = None

    def check(self, kept: bool, what: str) -> None:
        """Raise Broken unless the scene's rule was `kept`."""
        if not kept:
            raise self.broken(what)

    def broken(self, what: str) -> Broken:
        """Return the error that says `what` this peer received."""
        return Broken("the messages of the protocol", f"at the {self.role}, {what}")

    def _receive(self, deadline: float) -> Message | None:
        assert self._connection is not None
        while True:
            self._connection.wait_at_most(max(0.0, deadline - clock.monotonic()))
            frames = self._connection.receive()
            if frames is not None:
                break
            if clock.monotonic() >= deadline:
                return None
        try:
            return decode(frames, FROM_HUB)
        except RemoteProtocolError as error:
            raise self.broken(f"something was received that is not at a message: {error}") from None


class Scene:
    """A separate session in which one rule is checked.

    Args:
        name: a prefix of the session's name.
        context: context of the connections.
        url: address of the hub.
        wait: timeout of each message, in seconds.
    """

    def __init__(self, name: str, context: Context, url: str, wait: float) -> None:
        self.context = context
        self.url = url
        self.wait = wait
        self.session: str = f"{name}-{chance.random_bytes(8).hex()}"
        self.calls: list[Message] = []
        self._peers: list[ScriptedPeer] = []
        self.experiment: ScriptedPeer = self.peer(Role.EXPERIMENT)
        self.agent: ScriptedPeer = self.peer(Role.AGENT)
        self.environment: ScriptedPeer = self.peer(Role.ENVIRONMENT)

    def peer(self, role: Role, *capabilities: str) -> ScriptedPeer:
        """Return one more peer, which has not greeted the hub."""
        self._peers.append(ScriptedPeer(self, role, capabilities))
        return self._peers[-1]

    def gather(self) -> None:
        """Let all three peers join."""
        for peer in (self.experiment, self.agent, self.environment):
            peer.join()

    def init(self) -> None:
        """Let all three peers join, and carry out RL_INIT."""
        self.gather()
        self.initialise()

    def initialise(self) -> None:
        """Carry out RL_INIT without a seed."""
        self.experiment.ask(Kind.RL_INIT, None)
        self.initialised()

    def initialised(self) -> None:
        """Answer the players' calls of an RL_INIT, and expect its reply."""
        self.environment.answers(Kind.ENV_INIT, gives=TASK_SPEC.encode())
        self.agent.answers(Kind.AGENT_INIT, body=TASK_SPEC.encode())
        self.experiment.expects_reply(Kind.RL_INIT, body=TASK_SPEC.encode())

    def begin(self) -> None:
        """Let all three peers join, and carry out RL_INIT and RL_START."""
        self.init()
        self.start()

    def start(self) -> None:
        """Carry out RL_START."""
        self.experiment.ask(Kind.RL_START)
        self.started()
        self.experiment.expects_reply(Kind.RL_START, body=saw(0) + did(0))

    def step(self, step: int, terminal: bool = False) -> None:
        """Carry out RL_STEP number `step`, from 1."""
        self.experiment.ask(Kind.RL_STEP)
        self.stepped(step, terminal)
        last = did(step - 1 if terminal else step)
        self.experiment.expects_reply(Kind.RL_STEP, reward(step), terminal, body=saw(step) + last)

    def first_step(self) -> int:
        """Ask for the first RL_STEP; return the number of the environment's call, which is not answered."""
        self.experiment.ask(Kind.RL_STEP)
        return self.environment.expects_call(Kind.ENV_STEP, body=did(0))

    def finish_first_step(self, number: int) -> None:
        """Answer the environment's call of the first RL_STEP, and complete the step."""
        self.environment.send(Kind.ENV_STEP, reward(1), False, seq=number, body=saw(1))
        self.agent.answers(Kind.AGENT_STEP, reward(1), body=saw(1), gives=did(1))
        self.experiment.expects_reply(Kind.RL_STEP, reward(1), False, body=saw(1) + did(1))

    def relay(
        self,
        request: Kind,
        *scalars: Value,
        body: bytes = b"",
        reply: tuple[Value, ...] = (),
        gives: bytes = b"",
    ) -> None:
        """Carry out a request that is a single call to a player, as RL_ENV_STEP is ENV_STEP."""
        call = Kind[request.name.removeprefix("RL_")]
        player = self.agent if CALLS[call].callee is Role.AGENT else self.environment
        self.experiment.ask(request, *scalars, body=body)
        player.answers(call, *scalars, body=body, reply=reply, gives=gives)
        self.experiment.expects_reply(request, *reply, body=gives)

    def episode(self, limit: int, length: int) -> None:
        """Carry out RL_EPISODE; the episode ends at step `length`."""
        self.experiment.expects_reply(Kind.RL_EPISODE, self.played(limit, length))

    def played(self, limit: int, length: int) -> bool:
        """Ask for RL_EPISODE, and answer the players' calls; return whether the episode reaches its end."""
        self.experiment.ask(Kind.RL_EPISODE, limit)
        self.started()
        last = length if limit == 0 else min(length, limit - 1)
        for step in range(1, last + 1):
            self.stepped(step, step == length)
        return last == length

    def started(self) -> None:
        """Answer the players' calls of a start."""
        self.environment.answers(Kind.ENV_START, gives=saw(0))
        self.agent.answers(Kind.AGENT_START, body=saw(0), gives=did(0))

    def stepped(self, step: int, terminal: bool = False) -> None:
        """Answer the players' calls of a step."""
        self.environment.answers(
            Kind.ENV_STEP, body=did(step - 1), reply=(reward(step), terminal), gives=saw(step)
        )
        if terminal:
            self.agent.answers(Kind.AGENT_END, reward(step))
        else:
            self.agent.answers(Kind.AGENT_STEP, reward(step), body=saw(step), gives=did(step))

    def counted(self, total: float, steps: int, episodes: int) -> None:
        """Ask for return, number of steps and number of episodes, and expect these values."""
        self.experiment.gets(Kind.RL_RETURN, total)
        self.experiment.gets(Kind.RL_NUM_STEPS, steps)
        self.experiment.gets(Kind.RL_NUM_EPISODES, episodes)

    def close(self) -> None:
        """Let all peers leave."""
        for peer in self._peers:
            peer.part()
