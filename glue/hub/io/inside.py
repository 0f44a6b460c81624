"""An experiment's connection to a hub in its own process: messages are handed over without a socket.

While a verb is carried out, the experiment's thread takes the turns of the hub's loop. So a verb costs no
switch between threads, which would take longer than a step.

A player, too, can be an object in this process, while the other player is a separate program. The
experiment's thread carries out its calls between two turns of the loop. They wait in a queue until then: if
carried out as soon as the hub makes them, each call would be nested in the previous one.
"""

from __future__ import annotations

import platform
from collections import deque
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Final

from glue.client.answers import ServedPlayer, failure
from glue.client.experiment import connect_over
from glue.engine.experiment import Experiment
from glue.errors import ConfigError
from glue.hub.config import DEFAULT_HUB, DEFAULT_SESSION, HubConfig
from glue.hub.io.server import Hub
from glue.hub.sessions import INSTANCE_SIZE
from glue.pace import Pace
from glue.roles import AgentLike, EnvironmentLike
from glue.system import chance, clock
from glue.system.spinning import Spin
from glue.wire.codec import clip
from glue.wire.messages import CALLS, PROTOCOL_VERSION, Kind, Message, Role

_WAITING = Pace()
_NO_PLAYERS: Mapping[Role, AgentLike | EnvironmentLike] = {}

_MAX_WAITING: Final = 10_000
"""Maximum number of messages for an experiment that does not receive them; with more, it is unreachable."""


class InsideTransport:
    """A connection to a hub that runs in another thread of this process.

    Args:
        hub: the hub, running or not.
        players: players that are objects in this process, by role.
        session: the session that they join.

    Attributes:
        connected: always true.
        connections: always one.

    Raises:
        PeerFailed: a player lacks a method of its role.
    """

    connected = True
    connections = 1

    def __init__(
        self,
        hub: Hub,
        players: Mapping[Role, AgentLike | EnvironmentLike] = _NO_PLAYERS,
        session: str = DEFAULT_SESSION,
    ) -> None:
        self._hub = hub
        self._wait = 1.0
        self._new = True
        self._request: Message | None = None  # not handed over yet
        self._received: deque[Message] = deque()
        self._calls: deque[tuple[_InsidePlayer, Message]] = deque()
        joining = [_InsidePlayer(role, player, self._calls) for role, player in players.items()]

        def join() -> None:
            for player in joining:
                hub.sessions.receive(player, player.hello(session), clock.monotonic())

        hub.loop.alone(join)

    # The peer's side.

    def wait_at_most(self, seconds: float) -> None:
        """Set how long `receive_message` waits, in seconds."""
        self._wait = seconds

    def spin_with(self, spin: Spin) -> None:
        """Do nothing: the hub's loop polls."""

    def send_message(self, message: Message) -> bool:
        """Hand the hub a message; return False if the hub is ending.

        A verb is handed over at the next `receive_message`, which has to take the turns of the loop anyway.
        """
        loop = self._hub.loop
        if message[0] in CALLS:
            self._request = message
            return loop.stopping is None

        def send() -> bool:
            if loop.stopping is not None:
                return False
            self._hub.sessions.receive(self, message, clock.monotonic())
            return True

        return loop.alone(send)

    def receive_message(self, max_body: int) -> Message | None:
        """Return the next message; None if none is received in time.

        The first call returns None at once: nothing comes before the peer has said HELLO.
        """
        if self._new:
            self._new = False
            return None
        loop, received = self._hub.loop, self._received
        try:
            loop.alone(self._take_turns)
        except BaseException:
            # The loop was interrupted in the middle of something.
            self._hub.stop("the experiment was interrupted in the middle of a verb")
            raise
        if not received and loop.stopping is not None:
            self._hub.join(self._wait)  # the hub says goodbye as it ends
        return received.popleft() if received else None

    def _take_turns(self) -> None:
        """Take turns, and carry out the players' calls, until a message is received or the time is over."""
        loop, received, calls = self._hub.loop, self._received, self._calls
        receive = self._hub.sessions.receive
        now = clock.monotonic()
        until = now + self._wait
        request, self._request = self._request, None
        if request is not None and loop.stopping is None:
            receive(self, request, now)
        while not received and loop.stopping is None and (left := until - clock.monotonic()) > 0:
            if not calls:
                loop.turn(left)
                continue
            player, call = calls.popleft()
            for answer in player.carry_out(call):
                receive(player, answer, clock.monotonic())

    def close(self, linger: float | None = None) -> None:
        """Do nothing: nothing is left to deliver."""

    # The hub's side, as a channel of the sessions.

    def deliver(self, message: Message) -> bool:
        """Hand the experiment a message; return False if too many wait for it."""
        received, kind = self._received, message[0]
        if len(received) >= _MAX_WAITING and kind is not Kind.GOODBYE:
            return False
        if not received or kind is not Kind.HEARTBEAT:  # any other shows as well that the hub is there
            received.append(message)
        return True

    def admits(self, role: Role, session: str) -> bool:
        """Return True: the process that runs a hub may take any role."""
        return True


class _InsidePlayer:
    """A player in the hub's process; a channel of the sessions.

    Args:
        role: its role.
        player: the agent or environment.
        calls: queue that receives each call to it.
    """

    def __init__(
        self, role: Role, player: AgentLike | EnvironmentLike, calls: deque[tuple[_InsidePlayer, Message]]
    ) -> None:
        self._role = role
        self._player = ServedPlayer(role, player)
        self._calls = calls
        self._gone = False

    def hello(self, session: str) -> Message:
        """Return the message by which it joins a session."""
        player = self._player
        instance = chance.random_bytes(INSTANCE_SIZE)
        codec = f"Python {platform.python_version()}"
        scalars = ((PROTOCOL_VERSION,), str(self._role), instance, player.name, codec, player.capabilities)
        return Message(Kind.HELLO, session, 1, scalars)

    def carry_out(self, call: Message) -> tuple[Message, ...]:
        """Return the answer to a call; if the player raises, an ERROR and its GOODBYE."""
        try:
            answer = self._player.answer(call)
        except (KeyboardInterrupt, SystemExit):
            raise
        except BaseException as error:  # also asyncio.CancelledError and GeneratorExit
            self._gone = True
            reason = clip(f"{type(error).__name__} in {call.kind.name.lower()}")
            return failure(call, error), Message(Kind.GOODBYE, call.session, 0, (reason,))
        return () if answer is None else (answer,)

    def deliver(self, message: Message) -> bool:
        """Take a message from the sessions; return False once the player has failed or was dismissed."""
        if self._gone:
            return False
        if message.kind in CALLS:
            self._calls.append((self, message))
        elif message.kind is Kind.GOODBYE or message.kind is Kind.REFUSE:
            self._gone = True
        return True

    def admits(self, role: Role, session: str) -> bool:
        """Return True: the process that runs a hub may take any role."""
        return True


@contextmanager
def host(
    agent: AgentLike | None = None,
    environment: EnvironmentLike | None = None,
    *,
    bind: str = DEFAULT_HUB,
    session: str = DEFAULT_SESSION,
    pace: Pace = _WAITING,
) -> Iterator[Experiment]:
    """Run a hub in this process, with these players as objects; yield its experiment.

    A player that is not given joins from outside, written in any language; verbs wait for it:

        with glue.host(environment=MyEnvironment()) as experiment:   # elsewhere: glue-agent sarsa
            experiment.rl_init(seed=1)
            experiment.rl_episode(max_steps=1000)

    A step is then one round trip between processes. With both players here, `glue.local` needs no hub at all.

    Args:
        agent: the agent; None to wait for one.
        environment: the environment; None to wait for one.
        bind: address at which players join, `tcp://HOST:PORT` or `ipc://PATH`; only from this machine.
        session: the session's name.
        pace: of the environment; with a rate, the agent has to be elsewhere.

    Raises:
        ConfigError: the address is in use or can be reached from other machines, no player is given, or the
            agent would keep the environment waiting.
        PeerFailed: a player lacks a method of its role.
    """
    given = ((Role.AGENT, agent), (Role.ENVIRONMENT, environment))
    players = {role: player for role, player in given if player is not None}
    if not players:
        raise ConfigError("give an agent or an environment; if both join from outside, use glue.connect")
    if pace.rate and agent is not None:
        raise ConfigError(
            "an agent in the process of the hub would keep the environment waiting: start it "
            "in its own process, or use glue.local for both players"
        )
    with Hub(HubConfig(bind=(bind,), pace=pace)) as hub:
        transport = InsideTransport(hub, players, session)
        with hub.in_background(), connect_over(transport, session) as experiment:
            yield experiment
