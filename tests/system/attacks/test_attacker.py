"""Hostile peers: the hub's memory is bounded, and honest sessions play as if there were no others."""

from __future__ import annotations

import socket
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any

import pytest

from glue.client.experiment import connect
from glue.client.target import find_target
from glue.engine.local import local
from glue.types import Observation
from glue.wire.limits import MAX_BODY
from glue.wire.messages import Kind
from tests.keyed import KeyFolder
from tests.players import ChainAgent, ChainEnvironment
from tests.proof import size
from tests.scripted.peer import TIMEOUT
from tests.scripted.process import running
from tests.system.attacks.attacker import HONEST
from tests.system.attacks.test_bad_input import Target, quiet

LIMIT = 64
"""Megabytes that the hub may keep."""

MOST = LIMIT + 64
"""Megabytes that its process may hold."""

SECONDS = size(6.0, 300.0)


@contextmanager
def hub(*options: str, most: int = MOST) -> Iterator[tuple[str, Target]]:
    """A hub in a process of its own, which forgets nobody for a minute."""
    command = ["-c", "from glue.cli.hub import main; main()", "--bind", "tcp://127.0.0.1:*", "--quiet"]
    with running(*command, "--max-memory", str(LIMIT), "--timeout", "60", *options) as process:
        assert process.stderr is not None
        url = process.stderr.readline().split()[-1]
        threading.Thread(target=process.stderr.read, daemon=True).start()
        yield url, Target(url, process, None)  # type: ignore[arg-type]
        assert process.poll() is None, "the hub has died"
        status = Path(f"/proc/{process.pid}/status").read_text()
        peak = int(status.split("VmHWM:")[1].split()[0]) // 1024
        assert peak <= most


@pytest.mark.parametrize("stay", [False, True], ids=["and leave", "and stay"])
def test_peers_that_stop_in_the_middle_of_large_frames_fill_no_memory(stay: bool) -> None:
    with hub() as (_, target), ExitStack() as staying:
        for number in range(40):
            with ExitStack() as leaving:
                stack = staying if stay else leaving
                peer = stack.enter_context(target.greeted())
                peer.join("agent", session=f"session {number}")
                with suppress(OSError):  # it may be dropped
                    peer.send_bytes(b"\x02" + struct.pack(">Q", MAX_BODY))
                    for _ in range(15):
                        peer.send_bytes(bytes(2**20))


def test_many_sessions_with_the_largest_bodies_have_a_bound_in_all() -> None:
    # A call that is under way is in memory twice for a moment: as it was received and as it is sent.
    huge = Observation(chars=bytes(MAX_BODY - 16)).body
    with hub(most=MOST + 64) as (_, target), target.greeted() as agent, target.greeted() as experiment:
        reading = threading.Thread(target=agent.read_to_end)
        reading.start()
        for number in range(12):
            session = f"huge {number}"
            agent.hello("agent", session=session)
            experiment.hello("experiment", session=session)
            experiment.say(Kind.RL_AGENT_START, 1, body=huge, session=session)
        while (message := experiment.receive()).kind is not Kind.GOODBYE:
            pass
        assert "max_memory" in str(message.scalars[0])
        agent.socket.shutdown(socket.SHUT_RDWR)
        reading.join(TIMEOUT)


_PLAYERS = """
import sys
from glue import serve_agent, serve_environment
from tests.players import ChainAgent, ChainEnvironment

role, url, key, hub_key, *sessions = sys.argv[1:]
serve, make = (serve_agent, ChainAgent) if role == "agent" else (serve_environment, ChainEnvironment)
players = {name: make() for name in sessions}
serve(players, url, key=key or None, hub_key=hub_key or None, log=lambda line: None)
"""


class Honest:
    """An experiment that plays until it is told to stop."""

    def __init__(self, url: str, session: str, keys: Mapping[str, Any]) -> None:
        self.returns: list[float] = []
        self._stop = threading.Event()
        self._glue = connect(url, session, log=quiet, **keys)
        self._thread = threading.Thread(target=self._play, daemon=True)
        self._thread.start()

    def _play(self) -> None:
        with self._glue as glue:
            glue.rl_init()
            while not self._stop.is_set():
                assert glue.rl_episode()
                self.returns.append(glue.rl_return())

    def finish(self) -> list[float]:
        self._stop.set()
        self._thread.join(TIMEOUT)
        assert not self._thread.is_alive()
        return self.returns


@pytest.mark.proof
@pytest.mark.timeout(900)
@pytest.mark.parametrize("keyed", [False, True], ids=["without keys", "with keys"])
def test_honest_sessions_play_beside_an_attacker_as_if_alone(keyed: bool, tmp_path: Path) -> None:
    options: tuple[str, ...] = ()
    ours: dict[str, Any] = {}
    theirs: tuple[str, ...] = ()
    if keyed:
        folder = KeyFolder(tmp_path)
        carol, mallory = folder.entrant("carol"), folder.entrant("mallory")
        others = [f"m{number}" for number in range(40)]
        folder.allow(
            f'[carol]\nrole = ["agent", "environment", "experiment"]\nsession = {list(HONEST)}\n'
            f'[mallory]\nrole = ["agent", "environment", "experiment"]\nsession = {["m", *others]}\n'
        )
        options = ("--keys", str(folder.path))
        ours = {"key": carol, "hub_key": folder.hub_key}
        own = find_target(None, None, mallory, folder.hub_key).key
        assert own is not None
        theirs = (own.pair.public.hex(), own.pair.secret.hex(), own.hub.hex())
    with hub(*options) as (url, _), ExitStack() as stack:
        files = [str(ours.get(name, "")) for name in ("key", "hub_key")]
        for role in ("agent", "environment"):
            stack.enter_context(running("-c", _PLAYERS, role, url, *files, *HONEST))
        sessions = [Honest(url, name, ours) for name in HONEST]
        alone = _episodes(sessions, SECONDS / 4)
        command = [sys.executable, "-m", "tests.system.attacks.attacker", url, "1", str(SECONDS), *theirs]
        with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as attacker:
            beside = _episodes(sessions, SECONDS)
            _, errors = attacker.communicate(timeout=TIMEOUT)
        assert (attacker.returncode, errors) == (0, "")
        played = [session.finish() for session in sessions]
    for returns in played:
        assert returns
        with local(ChainAgent(), ChainEnvironment()) as glue:
            glue.rl_init()
            for number, total in enumerate(returns):
                assert glue.rl_episode()
                assert glue.rl_return() == total, f"episode {number}"
    assert min(map(len, played)) > 3
    print(f"{beside:.1f} episodes per second, {alone:.1f} without the attacker")


def _episodes(sessions: list[Honest], seconds: float) -> float:
    """Return the episodes that are played in a second, of all sessions together."""
    before = sum(len(session.returns) for session in sessions)
    began = time.monotonic()
    time.sleep(seconds)
    return (sum(len(session.returns) for session in sessions) - before) / (time.monotonic() - began)
