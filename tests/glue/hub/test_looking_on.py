"""Observers over real sockets: the messages that they see; one that reads nothing delays nobody."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from itertools import islice

import pytest

from glue import connect
from glue.client.observer import AnswerSeen, StartSeen, StepSeen, TaskSpecSeen, observe
from glue.engine.experiment import Experiment
from glue.errors import HubClosed
from glue.hub.io.server import Hub
from glue.types import Action, Observation
from glue.wire.messages import Kind
from tests.hubs import running
from tests.players import ScriptedAgent, ScriptedEnvironment
from tests.scripted.peer import TIMEOUT, ScriptedPeer


def wanted(hub: Hub) -> int:
    """Return how many moments the observers of the session want; 0 until the hub has their request."""
    observers = hub.sessions._by_name["default"].observers
    return 0 if observers is None else sum(observer.wanted for observer in observers._all.values())


class Large(ScriptedEnvironment):
    """An environment whose observations have 200,000 chars."""

    def env_step(self, action: Action) -> tuple[float, Observation, bool]:
        return 1.0, Observation(chars=bytes(200_000)), False


@contextmanager
def playing(environment: ScriptedEnvironment) -> Iterator[tuple[Hub, Experiment]]:
    with (
        running(ScriptedAgent(), environment, heartbeat=0.05, farewell=0.1) as hub,
        connect(hub.endpoints[0], wait=TIMEOUT) as glue,
    ):
        glue.wait_for_players(lambda missing: None)
        yield hub, glue


def test_an_observer_sees_what_is_played_and_what_the_agent_answers_until_the_session_is_over() -> None:
    environment = ScriptedEnvironment(length=3)
    with playing(environment) as (hub, glue):
        glue.rl_init()
        observer = observe(hub.endpoints[0], wait=TIMEOUT)
        observer.want(100)
        assert isinstance(observer.receive(), TaskSpecSeen)
        while not wanted(hub):
            observer.receive()  # a heartbeat
        first = glue.rl_start()
        steps = [glue.rl_step() for _ in range(3)]
        glue.rl_agent_message("values")
        start, *moments, answer = islice(observer, 5)
        assert start == StartSeen(1, first.observation)
        assert [(m.reward, m.terminal, m.observation) for m in moments if isinstance(m, StepSeen)] == [
            (s.reward, s.terminal, s.observation) for s in steps
        ]
        last = moments[-1]
        assert isinstance(last, StepSeen)
        assert (last.episode_return, last.num_steps) == (glue.rl_return(), glue.rl_num_steps())
        assert isinstance(answer, AnswerSeen)
        assert answer.message == "values"
        assert observer.missed == 0
    with observer, pytest.raises(HubClosed):
        list(observer)


def test_an_observer_that_reads_nothing_is_not_waited_for_and_costs_a_bounded_amount_of_memory() -> None:
    with playing(Large()) as (hub, glue), ScriptedPeer(hub.endpoints[0], receive_buffer=4096) as stuck:
        glue.rl_init()
        stuck.greet().hello("observer")
        stuck.say(Kind.OBSERVE, 0, 2**62)
        while not wanted(hub):
            glue.rl_num_steps()
        glue.rl_start()
        for _ in range(200):  # 40 MB
            glue.rl_step()
        unsent = [channel.connection.unsent for channel in hub._channels._open]
        assert max(unsent) < 1_000_000
