"""A hub with ports for original programs, and our verbs over the connection of an original experiment."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from functools import partial
from typing import Any

import pytest
import zmq

from glue import Agent, Environment, connect, serve_agent, serve_environment
from glue.client.experiment import RemoteExperiment
from glue.client.libzmq import Context
from glue.hub.config import HubConfig, LegacyPort
from glue.hub.io.server import Hub
from glue.legacy import peers
from glue.legacy.experiment import LegacyExperiment
from glue.legacy.gateway import Gateway
from glue.legacy.peers import LegacyPeer, LegacyPlayer
from glue.wire.messages import MAX_BODY, Message
from tests.system.legacy.legacy_client import STYLES, TIMEOUT, Connection, OriginalExperiment, Style, play
from tests.system.runs import wait_until

C = STYLES["c"]
_ASIDE = "aside"


class Log:
    """A log that keeps its lines, and lets a test wait for one."""

    def __init__(self) -> None:
        self._news = threading.Condition()
        self._lines: list[str] = []

    def __call__(self, line: str) -> None:
        with self._news:
            self._lines.append(line)
            self._news.notify_all()

    def __str__(self) -> str:
        with self._news:
            return "\n".join(self._lines)

    def wait_for(self, text: str, times: int = 1) -> None:
        """Wait until that many lines hold `text`."""

        def there() -> bool:
            return sum(text in line for line in self._lines) >= times

        with self._news:
            assert self._news.wait_for(there, TIMEOUT), f"{text!r} is not in {self._lines}"


class Rig:
    """A hub with one port for each session, and the programs that use them."""

    def __init__(self, hub: Hub, gateway: Gateway, context: Context, log: Log) -> None:
        self.hub = hub
        self.url = hub.endpoints[0]
        self.log = log
        self.experiments = ExitStack()
        self._context = context
        self._ports = {port.session: port.port for port in gateway.ports}
        self._threads: list[threading.Thread] = []
        self._failures: list[BaseException] = []

    def port(self, session: str = "default") -> int:
        """Return the port of a session."""
        return self._ports[session]

    def connect(self, style: Style = C, session: str = "default") -> Connection:
        """Connect as an original program does."""
        return Connection(self.port(session), style)

    def experiment(self, style: Style = C, session: str = "default") -> OriginalExperiment:
        """Connect as an original experiment, which leaves before the hub ends."""
        return self.experiments.enter_context(OriginalExperiment(self.connect(style, session)))

    def settle(self) -> None:
        """Wait until the hub has acted on everything it has received so far."""
        with OriginalExperiment(self.connect(session=_ASIDE)) as aside:
            for _ in range(2):
                aside.rl_num_steps()

    def wait_until_empty(self, session: str) -> None:
        """Wait until a session has no peers any more.

        The hub keeps the role of a program that has closed its sending half and is still owed replies, for as
        long as a request may take.
        """
        self.settle()
        wait_until(lambda: session not in self.hub.sessions._by_name, f"{session!r} to be empty")

    def native(self, session: str = "default") -> RemoteExperiment:
        """Connect as one of our experiments."""
        return connect(self.url, session, context=self._context)

    def originals(self, *players: Agent | Environment, style: Style = C) -> None:
        """Let players play as original programs, each in a thread."""
        for player in players:
            self._start(partial(play, player, self.connect(style)))

    def ours(self, *players: Agent | Environment, session: str = "default") -> None:
        """Let our players play, each in a thread."""
        for player in players:
            serve: Any = serve_agent if isinstance(player, Agent) else serve_environment
            self._start(partial(serve, player, self.url, session, context=self._context))

    def _start(self, program: Callable[[], object]) -> None:
        def run() -> None:
            try:
                program()
            except BaseException as error:  # raised again by `join`
                self._failures.append(error)

        thread = threading.Thread(target=run)
        self._threads.append(thread)
        thread.start()

    def join(self) -> None:
        """Wait until every program has ended; raise the error of one that failed."""
        for thread in self._threads:
            thread.join(TIMEOUT)
            assert not thread.is_alive(), f"a program has not ended; the log:\n{self.log}"
        self._threads.clear()
        if self._failures:
            raise self._failures.pop()


@contextmanager
def gateway(
    *sessions: str, timeout: float = 60.0, max_body: int = MAX_BODY, max_memory: int = 2**30
) -> Iterator[Rig]:
    """Run a hub with a port for each session, or for `default`; all programs must end with the hub.

    Only a test that waits for the end of `timeout` sets it, and then no other program joins that hub.
    """
    log = Log()
    with _true_accounts(), zmq.Context() as context:
        config = HubConfig(
            ("tcp://127.0.0.1:*",), min(0.2, timeout / 4), timeout, max_body=max_body, max_memory=max_memory
        )
        hub = Hub(config, log)
        ports = [LegacyPort(0, session) for session in (*(sessions or ("default",)), _ASIDE)]
        rig = Rig(hub, Gateway(hub, ports, log), context, log)
        try:
            with hub.in_background(), rig.experiments:
                yield rig
        finally:
            rig.join()


@contextmanager
def _true_accounts() -> Iterator[None]:
    """Check that the memory of each program is accounted for after each of its turns and messages."""
    wrong: list[str] = []
    at_work: list[LegacyPeer] = []

    def check(peer: LegacyPeer) -> None:
        connection = peer._connection
        kept = peer._decoder.buffered + connection.unsent + peer._kept()
        used = 0 if connection.closed else peers.BASE + kept
        held = peer._sessions.memory.accounts.get(peer, 0)
        if held != used:
            wrong.append(f"{type(peer).__name__} uses {used} bytes and accounts for {held}")

    def check_class(patched: pytest.MonkeyPatch, of: type[LegacyPeer]) -> None:
        turn, deliver = of.ready, of.deliver

        def checked_turn(peer: Any, now: float) -> None:
            at_work.append(peer)
            try:
                turn(peer, now)
            finally:
                at_work.remove(peer)
            check(peer)

        def checked_delivery(peer: Any, message: Message) -> bool:
            open_before = not peer._connection.closed
            delivered = deliver(peer, message)
            if open_before and peer not in at_work:
                check(peer)
            return delivered

        patched.setattr(of, "ready", checked_turn)
        patched.setattr(of, "deliver", checked_delivery)

    with pytest.MonkeyPatch.context() as patched:
        check_class(patched, LegacyPlayer)
        check_class(patched, LegacyExperiment)
        yield
    assert not wrong
