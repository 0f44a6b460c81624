"""Peers of the first version play with today's hub, and today's peers with the hub of the first version.

tests/golden/conversation.jsonl holds the messages between a hub, an agent, an environment and an experiment
of the first version (0.1.0, before its modules were put into folders), without heartbeats: one line for each
message, with the peer, whether the peer `sent` or `received` it, and its frames. Both sides of the
conversation are replayed here.
"""

from __future__ import annotations

import json
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any, Final, NamedTuple

import msgpack

from glue import Action, Observation, connect, serve_agent, serve_environment
from glue.hub.config import HubConfig
from glue.hub.io.server import Hub
from glue.wire.messages import Kind, Message
from tests.players import SeededAgent, SeededEnvironment
from tests.scripted.hub import ScriptedHub
from tests.scripted.peer import TIMEOUT, ScriptedPeer

RECORDED: Final = Path(__file__).parents[1] / "golden/conversation.jsonl"
ROLES: Final = ("agent", "environment", "experiment")
CONFIG: Final = HubConfig(bind=("tcp://127.0.0.1:*",), heartbeat=0.5, timeout=60.0, greeting=60.0)
_NEWER: Final = ("extras", "mask", "outcome", "pace", "truncate")
"""Capabilities that the first hub does not know, and ignores."""


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


def received(end: ScriptedPeer | ScriptedHub) -> list[bytes]:
    """Return the frames of the next message that is not a heartbeat."""
    while header(frames := end.receive_frames())[0] == Kind.HEARTBEAT:
        pass
    return frames


def test_todays_hub_answers_the_first_peers_to_the_byte() -> None:
    with Hub(CONFIG).in_background() as hub, ExitStack() as closing:
        peers = {role: closing.enter_context(ScriptedPeer(hub.endpoints[0]).greet()) for role in ROLES}
        for event in recorded():
            if event.sent:
                peers[event.role].send(*event.frames)
            else:
                assert received(peers[event.role]) == event.frames


def run_verbs(url: str) -> None:
    """Call the verbs of the recorded experiment."""
    with connect(url) as glue:
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


def test_todays_peers_answer_the_first_hub_to_the_byte() -> None:
    greetings: dict[str, int] = {}
    with ExitStack() as ending:
        hubs = {role: ending.enter_context(ScriptedHub()) for role in ROLES}
        for role in ROLES:
            ending.callback(start(role, hubs[role].url).join, TIMEOUT)
        for event in recorded():
            if not event.sent:
                kind, session, seq, *scalars = header(event.frames)
                if kind == Kind.WELCOME:
                    seq = greetings[event.role]  # A hub of any version repeats the number of the HELLO.
                first = msgpack.packb([kind, session, seq, *scalars])
                hubs[event.role].send_frames(first, *event.frames[1:])
                continue
            frames = received(hubs[event.role])
            if event.kind == Kind.HELLO:
                hello, expected = header(frames), header(event.frames)
                greetings[event.role] = hello[2]
                for varying in (2, 5, 7):  # the number, the instance, the version of Python
                    hello[varying] = expected[varying]
                hello[8] = [name for name in hello[8] if name not in _NEWER]
                assert hello == expected
            else:
                assert frames == event.frames
        for role in ("agent", "environment"):
            hubs[role].send(Message(Kind.GOODBYE, "default", 0, ("over",)))


def start(role: str, url: str) -> threading.Thread:
    """Let a peer of today play the role."""
    programs: dict[str, Callable[[], object]] = {
        "agent": lambda: serve_agent(SeededAgent(), url),
        "environment": lambda: serve_environment(SeededEnvironment(), url),
        "experiment": lambda: run_verbs(url),
    }
    thread = threading.Thread(target=programs[role], daemon=True)
    thread.start()
    return thread
