"""A hub's account of its memory is true after every message: by what its objects weigh."""

from __future__ import annotations

import threading
from collections.abc import Callable
from contextlib import ExitStack
from typing import Any

import pytest

from glue.hub.config import HubConfig
from glue.hub.io.server import Hub
from glue.types import Observation
from glue.wire.messages import CALLS, MAX_NAME, PROTOCOL_VERSION, THREE_ROLES, Body, Kind, Role
from tests.glue.hub.test_sessions import Rig, instance
from tests.scripted.peer import TIMEOUT, ScriptedPeer
from tests.weighing import check, check_sessions, size_of

HEAVY = 500_000


def text() -> bytes:
    return bytes(HEAVY)


def observation() -> bytes:
    return Observation(chars=bytes(HEAVY - 16)).body


class Weighed(Rig):
    """A rig that weighs its sessions after every message; players answer with heavy bodies."""

    def __init__(self) -> None:
        super().__init__(HubConfig(timeout=5.0))
        self.heavy = True
        self.requests = 0
        self.fill()

    def put(self, channel: str, *message: Any, **more: Any) -> None:
        super().put(channel, *message, **more)
        check_sessions(self.sessions)

    def usual(self, kind: Kind) -> tuple[tuple[Any, ...], bytes]:
        scalars, body = super().usual(kind)
        if not self.heavy or not body:
            return scalars, body
        return scalars, text() if CALLS[kind].reply.body is Body.TEXT else observation()

    def request(self, kind: Kind, *scalars: Any, body: bytes = b"") -> None:
        """Let the experiment make a request."""
        self.requests += 1
        self.put("x", kind, self.requests, *scalars, body=body)

    def each_answers(self, channels: str) -> None:
        """Let players answer one call each, in this order."""
        for channel in channels:
            self.answer(channel)

    def init(self) -> None:
        self.request(Kind.RL_INIT, None)
        self.each_answers("ea")

    def start(self) -> None:
        self.init()
        self.request(Kind.RL_START)
        self.each_answers("ea")

    def replace(self, channel: str) -> None:
        """Let another player take the role of `a` or `e`."""
        self.put(channel, Kind.GOODBYE, 0, "enough")
        self.hello(channel, {"a": Role.AGENT, "e": Role.ENVIRONMENT}[channel], who=f"another {channel}")

    @property
    def held(self) -> int:
        """What the only session accounts for, in bodies."""
        return sum(self.sessions.memory.accounts.values()) // HEAVY


def an_episode(rig: Weighed) -> int:
    rig.init()
    rig.request(Kind.RL_EPISODE, 0)
    rig.each_answers("eaeaeaea")
    rig.answer("e", 1.0, True)
    return 3  # the task spec, the action, and the observation that came with the end


def a_step_that_ends_the_episode(rig: Weighed) -> int:
    rig.start()
    rig.request(Kind.RL_STEP)
    rig.answer("e", 1.0, True)
    return 3  # the task spec, the action, and the observation for the reply


def the_reply_to_a_step(rig: Weighed) -> int:
    rig.start()
    rig.request(Kind.RL_STEP)
    rig.each_answers("ea")
    return 4  # the task spec, the action, and the reply of two bodies


def a_new_environment_with_another_task(rig: Weighed) -> int:
    rig.start()
    rig.request(Kind.RL_CLEANUP)
    rig.each_answers("ea")
    rig.replace("e")
    rig.request(Kind.RL_EPISODE, 0)
    rig.answer("e", body=text()[1:] + b"!")
    rig.each_answers("eaa")
    return 3


def an_episode_that_becomes_light(rig: Weighed) -> int:
    rig.start()
    rig.heavy = False
    rig.start()
    return 0


@pytest.mark.parametrize(
    "scene",
    [
        an_episode,
        a_step_that_ends_the_episode,
        the_reply_to_a_step,
        a_new_environment_with_another_task,
        an_episode_that_becomes_light,
    ],
    ids=lambda scene: scene.__name__,
)
def test_a_session_accounts_for_the_bodies_that_it_keeps(scene: Callable[[Weighed], int]) -> None:
    rig = Weighed()
    assert scene(rig) == rig.held


@pytest.mark.parametrize(
    ("channel", "verb", "body", "answers", "kept"),
    [
        ("a", (Kind.RL_START,), b"", "e", 2),
        ("a", (Kind.RL_EPISODE, 0), b"", "eaaeaeae", 3),
        ("a", (Kind.RL_AGENT_MESSAGE,), text(), "", 2),
        ("e", (Kind.RL_ENV_STEP,), observation(), "", 2),
    ],
    ids=["observation", "episode", "message", "action"],
)
def test_a_session_accounts_for_what_it_keeps_for_a_new_player(
    channel: str, verb: tuple[Any, ...], body: bytes, answers: str, kept: int
) -> None:
    rig = Weighed()
    rig.init()
    rig.replace(channel)
    rig.request(*verb, body=body)
    rig.each_answers(answers)
    assert rig.held == kept


@pytest.mark.parametrize(("leaving", "kept"), [("a", 2), ("x", 0), ("xea", 0)])
def test_a_session_accounts_for_what_it_keeps_when_peers_have_left(leaving: str, kept: int) -> None:
    rig = Weighed()
    rig.start()
    rig.request(Kind.RL_STEP)
    for channel in leaving:
        rig.put(channel, Kind.GOODBYE, 0, "enough")
    assert rig.held == kept
    assert (rig.sessions.memory.total == 0) is (leaving == "xea")


def test_a_session_with_the_longest_names_weighs_no_more_than_its_fixed_part() -> None:
    wide = "\N{GRINNING FACE}" * MAX_NAME
    rig = Rig(HubConfig())
    for role in THREE_ROLES:
        scalars = ((PROTOCOL_VERSION,), role, instance(role), wide, wide, ("seed", "save", "x" * 500))
        rig.put(role, Kind.HELLO, 0, *scalars, session=wide)
    for _ in range(2):
        rig.put("experiment", Kind.RL_EPISODE, 1, 0, session=wide)
        for player in (Role.AGENT, Role.ENVIRONMENT):
            rig.put(player, Kind.GOODBYE, 0, "x" * 3000, session=wide)
        check_sessions(rig.sessions)
    assert size_of(rig.sessions._by_name.values()) > 8000


def test_a_connection_accounts_for_what_it_has_received_and_not_sent() -> None:
    hub = Hub(HubConfig(bind=("tcp://127.0.0.1:*",), heartbeat=0.05, greeting=TIMEOUT, farewell=0.0))
    (url,) = hub.endpoints
    body = bytes(8 * 2**20)
    full = threading.Event()

    def weigh(now: float) -> None:
        check(hub)
        # The reply, kept by the session and by the connection that it waits for, and half a message.
        if hub.sessions.memory.total > 3 * len(body):
            full.set()

    hub.loop.on_tick(weigh)
    with hub.in_background(), ExitStack() as stack:
        agent, half = (stack.enter_context(ScriptedPeer(url).greet()) for _ in range(2))
        experiment = stack.enter_context(ScriptedPeer(url, receive_buffer=4096).greet())
        agent.join("agent")
        half.join("agent", session="half")
        experiment.join("experiment")
        experiment.say(Kind.RL_AGENT_MESSAGE, 1)
        agent.say(Kind.AGENT_MESSAGE, agent.receive().seq, body=body)
        half.send_bytes(half.encoded(*half.frames_of(Kind.AGENT_MESSAGE, 1, body=body))[:-1])
        assert full.wait(TIMEOUT)
