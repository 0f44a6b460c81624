"""Observers over real sockets: what they see, and that one which reads nothing holds nobody up."""

from __future__ import annotations

import socket
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import islice
from threading import Thread

import pytest

from glue import connect, serve_agent, serve_environment
from glue.client.observer import Answer, Start, Step, TaskSpecSeen, observe
from glue.core.config import Bind, HubConfig
from glue.core.experiment import Experiment
from glue.errors import HubClosed, Refused
from glue.hub.server import Hub
from glue.protocol import zmtp
from glue.protocol.messages import THREE_ROLES, Kind, Message, Role
from glue.protocol.wire import TO_HUB, encode
from glue.types import Action, Observation
from tests.players import ScriptedAgent, ScriptedEnvironment

WAIT = 20.0


def quiet(line: str) -> None:
    """Say nothing."""


def wanted(hub: Hub) -> int:
    """How many moments the observers of the session want; 0 until the hub has heard of it."""
    observers = hub.switchboard._sessions["default"].observers
    return 0 if observers is None else sum(view.wanted for view in observers._views.values())


class Large(ScriptedEnvironment):
    """Its observations have 200,000 chars."""

    def env_step(self, action: Action) -> tuple[float, Observation, bool]:
        return 1.0, Observation(chars=bytes(200_000)), False


@contextmanager
def playing(environment: ScriptedEnvironment) -> Iterator[tuple[Hub, Experiment]]:
    bind = ("tcp://127.0.0.1:*", Bind("tcp://127.0.0.1:*", frozenset(THREE_ROLES)))
    with Hub(HubConfig(bind=bind, heartbeat=0.05)).in_background() as hub:
        address = hub.endpoints[0]
        players = [
            Thread(target=serve_agent, args=({"default": ScriptedAgent()}, address), kwargs={"log": quiet}),
            Thread(target=serve_environment, args=({"default": environment}, address), kwargs={"log": quiet}),
        ]
        for player in players:
            player.start()
        with connect(address, wait=WAIT, log=quiet) as glue:
            glue.wait_for_players(lambda missing: None)
            yield hub, glue
    for player in players:
        player.join()


def test_an_observer_sees_what_is_played_and_what_the_agent_answers() -> None:
    environment = ScriptedEnvironment(length=3)
    with playing(environment) as (hub, glue):
        glue.rl_init()
        with observe(hub.endpoints[0], wait=WAIT, log=quiet) as observer:
            observer.want(100)
            assert isinstance(observer.receive(), TaskSpecSeen)
            while not wanted(hub):
                observer.receive()  # a heartbeat
            first = glue.rl_start()
            steps = [glue.rl_step() for _ in range(3)]
            glue.rl_agent_message("values")
            seen = list(islice(observer, 5))
        start, *moments, answer = seen
        assert start == Start(1, first.observation)
        assert [(m.reward, m.terminal, m.observation) for m in moments if isinstance(m, Step)] == [
            (s.reward, s.terminal, s.observation) for s in steps
        ]
        last = moments[-1]
        assert isinstance(last, Step)
        assert (last.episode_return, last.num_steps) == (glue.rl_return(), glue.rl_num_steps())
        assert isinstance(answer, Answer)
        assert answer.message == "values"
        assert observer.missed == 0


def test_where_only_who_takes_part_may_connect_an_observer_is_refused() -> None:
    with playing(ScriptedEnvironment()) as (hub, _), pytest.raises(Refused, match="no observer of session"):
        observe(hub.endpoints[1], wait=WAIT, log=quiet)


def test_an_observer_is_told_when_the_session_is_over() -> None:
    with playing(ScriptedEnvironment()) as (hub, _):
        observer = observe(hub.endpoints[0], wait=WAIT, log=quiet)
    with observer, pytest.raises(HubClosed):
        list(observer)


def test_an_observer_that_reads_nothing_is_not_waited_for_and_costs_a_bounded_amount_of_memory() -> None:
    with playing(Large()) as (hub, glue), socket.socket() as stuck:
        glue.rl_init()
        stuck.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        host, port = hub.endpoints[0].removeprefix("tcp://").split(":")
        stuck.connect((host, int(port)))
        ready = bytes.fromhex(
            "04290552454144590b536f636b65742d54797065000000064445414c4552084964656e7469747900000000"
        )
        hello = Message(Kind.HELLO, "default", 0, ((1,), str(Role.OBSERVER), b"o" * 16, "stuck", "test", ()))
        wants = Message(Kind.OBSERVE, "default", 0, (2**62,))
        stuck.sendall(zmtp.GREETING)
        stuck.recv(64, socket.MSG_WAITALL)
        stuck.sendall(ready)
        for message in (hello, wants):
            stuck.sendall(zmtp.encode(encode(message, TO_HUB)))
        while not wanted(hub):
            glue.rl_num_steps()
        glue.rl_start()
        for _ in range(200):  # 40 MB
            glue.rl_step()
        unsent = [dealer.connection.unsent for dealer in hub._router._dealers]
        assert max(unsent) < 1_000_000
