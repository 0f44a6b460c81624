"""Peers of the first version play with today's hub, and today's peers with the hub of the first version.

tests/golden/conversation.jsonl is what a hub, an agent, an environment and an experiment of the first
version (0.1.0, before its modules were put into folders) said to each other, without heartbeats: one line
for each message, with the peer, whether it `sent` or `received` it, and its frames. Either side of it is
played again here.
"""

from __future__ import annotations

import json
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any, Final, NamedTuple

import msgpack
import pytest
import zmq

from glue.client.experiment import connect
from glue.client.libzmq import Context
from glue.client.players import serve_agent, serve_environment
from glue.core.config import HubConfig
from glue.hub.server import Hub
from glue.protocol.messages import Kind
from glue.types import Action, Observation
from tests.players import SeededAgent, SeededEnvironment
from tests.system.peer import TIMEOUT

RECORDED: Final = Path(__file__).parents[1] / "golden/conversation.jsonl"
ROLES: Final = ("agent", "environment", "experiment")
CONFIG: Final = HubConfig(bind=("tcp://127.0.0.1:*",), heartbeat=0.5, timeout=60.0)

Sockets = Callable[[int], dict[str, "zmq.Socket[bytes]"]]


class Event(NamedTuple):
    """One message of the recorded conversation, as a peer saw it."""

    role: str
    sent: bool
    frames: list[bytes]

    @property
    def kind(self) -> int:
        return int(header(self.frames)[0])


def header(frames: list[bytes]) -> Any:
    return msgpack.unpackb(frames[0])


def recorded() -> Iterator[Event]:
    for line in RECORDED.read_text().splitlines():
        role, direction, frames = json.loads(line)
        yield Event(role, direction == "sent", [bytes.fromhex(frame) for frame in frames])


@pytest.fixture
def context() -> Iterator[Context]:
    context: Context = zmq.Context()
    yield context
    context.destroy(linger=0)


@pytest.fixture
def sockets(context: Context) -> Iterator[Sockets]:
    """Makes a socket for each role."""
    with ExitStack() as closing:

        def make(kind: int) -> dict[str, zmq.Socket[bytes]]:
            made = {role: closing.enter_context(context.socket(kind)) for role in ROLES}
            for each in made.values():
                each.setsockopt(zmq.RCVTIMEO, int(TIMEOUT * 1000))
            return made

        yield make


def test_the_recording_has_every_call_of_an_experiment_without_saves() -> None:
    kinds = {Kind(event.kind) for event in recorded()}
    assert {kind for kind in Kind if kind not in kinds} == {
        Kind.REFUSE,
        Kind.HEARTBEAT,
        Kind.ERROR,
        *(kind for kind in Kind if kind.name.endswith(("_SAVE", "_LOAD"))),
        *(kind for kind in Kind if kind.name.startswith("OBSERVE")),  # the first version had no observers
    }


def test_todays_hub_answers_the_first_peers_to_the_byte(sockets: Sockets) -> None:
    with Hub(CONFIG).in_background() as hub:
        peers = sockets(zmq.DEALER)
        for peer in peers.values():
            peer.connect(hub.endpoints[0])
        for event in recorded():
            if event.sent:
                peers[event.role].send_multipart(event.frames)
                continue
            received = peers[event.role].recv_multipart()
            while header(received)[0] == Kind.HEARTBEAT:
                received = peers[event.role].recv_multipart()
            assert received == event.frames


def run_verbs(url: str, context: Context) -> None:
    """What the recorded experiment did."""
    with connect(url, context=context, log=lambda line: None) as glue:
        glue.wait_for_players(lambda missing: None)
        glue.rl_init(seed=7)
        glue.rl_start()
        glue.rl_step()
        glue.rl_episode(2)
        glue.rl_episode()
        glue.rl_return()
        glue.rl_num_steps()
        glue.rl_num_episodes()
        glue.rl_agent_message("größer")
        glue.rl_env_message("")
        glue.rl_env_start()
        glue.rl_env_step(Action([1], [0.5], b"c"))
        glue.rl_agent_start(Observation([1]))
        glue.rl_agent_step(-0.5, Observation([2], [1e300]))
        glue.rl_agent_end(2.0)
        glue.rl_cleanup()


def test_todays_peers_answer_the_first_hub_to_the_byte(context: Context, sockets: Sockets) -> None:
    ends = sockets(zmq.ROUTER)
    routes: dict[str, bytes] = {}
    greetings: dict[str, int] = {}
    with ExitStack() as ending:
        for role in ROLES:
            ends[role].bind("tcp://127.0.0.1:*")
            url = ends[role].getsockopt_string(zmq.LAST_ENDPOINT)
            ending.callback(start(role, url, context).join, TIMEOUT)
        for event in recorded():
            if not event.sent:
                kind, session, seq, *scalars = header(event.frames)
                if kind == Kind.WELCOME:
                    seq = greetings[event.role]  # A hub of any version repeats the number of the HELLO.
                first = msgpack.packb([kind, session, seq, *scalars])
                ends[event.role].send_multipart([routes[event.role], first, *event.frames[1:]])
                continue
            frames: list[Any] = [Kind.HEARTBEAT]
            while frames[0] == Kind.HEARTBEAT:
                routes[event.role], *received = ends[event.role].recv_multipart()
                frames = header(received)
            if event.kind == Kind.HELLO:
                greetings[event.role] = frames[2]
                expected = header(event.frames)
                for varying in (2, 5, 7):  # the number, the instance, the version of Python
                    frames[varying] = expected[varying]
                if event.role == "experiment":
                    frames[8].remove("outcome")  # the first hub knows no such capability, and ignores it
                assert frames == expected
            else:
                assert received == event.frames
        for role in ("agent", "environment"):
            goodbye = msgpack.packb([Kind.GOODBYE, "default", 0, "over"])
            ends[role].send_multipart([routes[role], goodbye])


def start(role: str, url: str, context: Context) -> threading.Thread:
    """Let a peer of today play the role."""
    programs: dict[str, Callable[[], object]] = {
        "agent": lambda: serve_agent(SeededAgent(), url, context=context, log=lambda line: None),
        "environment": lambda: serve_environment(
            SeededEnvironment(), url, context=context, log=lambda line: None
        ),
        "experiment": lambda: run_verbs(url, context),
    }
    thread = threading.Thread(target=programs[role], daemon=True)
    thread.start()
    return thread
