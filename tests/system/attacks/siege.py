"""A hub with four honest sessions under attack:

    python -m tests.system.attacks.siege SECONDS [keys]

The attacker has `SECONDS` in all, in turns. How fast sessions are beside attackers measures
`python -m benchmarks attacks`.
"""

from __future__ import annotations

import sys
import tempfile
import threading
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any, Final

from glue.client.experiment import connect
from glue.client.target import find_target
from glue.engine.local import local
from tests.keyed import KeyFolder
from tests.players import ChainAgent, ChainEnvironment
from tests.scripted.peer import TIMEOUT
from tests.scripted.process import running
from tests.system.attacks.attacker import HONEST
from tests.system.attacks.victim import victim

LIMIT: Final = 64 * 2**20
"""Bytes that the hub may keep."""

BESIDE: Final = 30 * 2**20
"""Bytes by which the memory of its process may grow besides."""

_TURN: Final = 20.0
"""Maximum duration of a turn of the attacker, in seconds."""

_PLAYERS: Final = """
import sys
from glue import serve_agent, serve_environment
from tests.players import ChainAgent, ChainEnvironment

role, url, key, hub_key, *sessions = sys.argv[1:]
serve, make = (serve_agent, ChainAgent) if role == "agent" else (serve_environment, ChainEnvironment)
players = {name: make() for name in sessions}
serve(players, url, key=key or None, hub_key=hub_key or None)
"""


@contextmanager
def players(url: str, sessions: Sequence[str], keys: Sequence[str] = ("", "")) -> Iterator[None]:
    """Start the players of honest sessions, each role in a process."""
    with ExitStack() as stack:
        for role in ("agent", "environment"):
            stack.enter_context(running("-c", _PLAYERS, role, url, *keys, *sessions))
        yield


class Honest:
    """An experiment that plays until it is stopped, and its twin in this process.

    Args:
        url: address of the hub.
        session: name of the session.
        keys: named arguments of `connect`.

    Attributes:
        played: number of episodes that have ended.
    """

    def __init__(self, url: str, session: str, keys: Mapping[str, Any]) -> None:
        self.played = 0
        self._returns: deque[float] = deque()
        self._ended = threading.Event()
        self._stop = threading.Event()
        self._twin = local(ChainAgent(), ChainEnvironment())
        self._twin.rl_init()
        self._glue = connect(url, session, **keys)
        self._thread = threading.Thread(target=self._play, daemon=True)
        self._thread.start()

    def _play(self) -> None:
        with self._glue as glue:
            glue.rl_init()
            while not self._stop.is_set():
                assert glue.rl_episode()
                self._returns.append(glue.rl_return())
                self.played += 1
                self._ended.set()

    def check(self) -> None:
        """Assert that episodes have ended since the last check, with the same returns as the twin's."""
        assert self._ended.wait(TIMEOUT), "the session stands still"
        self._ended.clear()
        while self._returns:
            assert self._twin.rl_episode()
            assert self._twin.rl_return() == self._returns.popleft()

    def finish(self) -> None:
        """Stop playing."""
        assert self._thread.is_alive(), "the session has failed"
        self._stop.set()
        self._thread.join(TIMEOUT)
        assert not self._thread.is_alive()


def besiege(seconds: float, keyed: bool, folder: Path) -> None:
    """Attack a hub; assert that its memory is bounded and its sessions continue as if alone.

    Args:
        seconds: duration of the attack.
        keyed: whether the hub, the sessions and the attacker have keys.
        folder: an empty directory for the keys.
    """
    keys, ours, theirs = make_keys(folder) if keyed else (None, {}, ())
    with victim(keys=keys, max_memory=LIMIT, greeting=1.0) as hub, ExitStack() as stack:
        url, idle = hub.url, hub.begin()
        files = [str(ours.get(name, "")) for name in ("key", "hub_key")]
        stack.enter_context(players(url, HONEST, files))
        sessions = [Honest(url, name, ours) for name in HONEST]
        for session in sessions:
            session.check()
        turns = max(1, round(seconds / _TURN))
        for turn in range(1, turns + 1):
            attacker = ["-m", "tests.system.attacks.attacker", url, str(turn)]
            with running(*attacker, str(seconds / turns), *theirs) as attack:
                _, errors = attack.communicate(timeout=seconds / turns + TIMEOUT)
                assert (attack.returncode, errors) == (0, "")
            for session in sessions:
                session.check()
            assert hub.most() - idle <= LIMIT + BESIDE
            print(
                f"turn {turn} of {turns}: {sum(session.played for session in sessions)} episodes as alone, "
                f"at most {hub.most() / 2**20:.0f} MiB",
                flush=True,
            )
        for session in sessions:
            session.finish()


def make_keys(folder: Path) -> tuple[Path, dict[str, Any], tuple[str, ...]]:
    """Make keys; return the directory of the hub, and what honest sessions and the attacker need."""
    keys = KeyFolder(folder)
    carol, mallory = keys.entrant("carol"), keys.entrant("mallory")
    others = [f"m{number}{part}" for number in range(40) for part in ["", *(f"-{n}" for n in range(32))]]
    keys.allow(
        f'[carol]\nrole = ["agent", "environment", "experiment"]\nsession = {list(HONEST)}\n'
        f'[mallory]\nrole = ["agent", "environment", "experiment", "observer"]\nsession = {["m", *others]}\n'
    )
    own = find_target(None, None, mallory, keys.hub_key).key
    assert own is not None
    return (
        keys.path,
        {"key": carol, "hub_key": keys.hub_key},
        (own.pair.public.hex(), own.pair.secret.hex(), own.hub.hex()),
    )


def _main(seconds: str, keyed: str = "") -> None:
    with tempfile.TemporaryDirectory() as folder:
        besiege(float(seconds), keyed == "keys", Path(folder))
    print("results equal, memory bounded")


if __name__ == "__main__":
    _main(*sys.argv[1:])
