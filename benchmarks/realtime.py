"""An environment that does not wait: how evenly it is stepped, and how many actions come late."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path

import numpy as np

from benchmarks.measure import Table
from benchmarks.players import SIZES, Walk
from glue.client.experiment import connect_over
from glue.client.libzmq import new_pair
from glue.hub.config import Bind, HubConfig, Keys, Permit
from glue.hub.io.inside import InsideTransport
from glue.hub.io.server import Hub
from glue.keys.certificates import write_pair
from glue.pace import Pace
from glue.types import Action, Observation, Step
from glue.wire.messages import Role

_ROOT = Path(__file__).parent.parent
_, _MARIO = SIZES
_RATES = (24.0, 100.0)
_SECONDS = 20.0
_PROGRAM = (sys.executable, "-m", "benchmarks.players", "agent", _MARIO)
_COMPILED = os.environ.get("GLUE_CPP_RANDOM", str(_ROOT / "clients/cpp/build/random"))
_PLAYERS: dict[str, tuple[Sequence[str], bool]] = {
    "Python": (_PROGRAM, False),
    "C++": ((_COMPILED,), False),
    "Python, encrypted": (_PROGRAM, True),
}
"""The program of each player, and whether it has keys."""
_LOOP = (sys.executable, "-c", "while True: pass")
_TASK = (
    "VERSION RL-Glue-3.0 PROBLEMTYPE episodic DISCOUNTFACTOR 1 OBSERVATIONS INTS (23 UNSPEC UNSPEC) "
    "DOUBLES (44 UNSPEC UNSPEC) CHARCOUNT 352 ACTIONS INTS (0 1) REWARDS (-1 1)"
)


class _Timed(Walk):
    """Notes the time of each step, and the sum of its rewards, in the hub's own process."""

    def __init__(self) -> None:
        super().__init__(SIZES[_MARIO])
        self.times: list[float] = []

    def env_init(self) -> str:
        return _TASK

    def env_start(self) -> Observation:
        self.times.clear()
        return super().env_start()

    def env_step(self, action: Action) -> Step:
        self.times.append(time.perf_counter())
        return super().env_step(action)


def run() -> list[Table]:
    """Measure players in time, alone and under load, and one that is stopped for a second."""
    if not Path(_COMPILED).exists():
        sys.exit(
            f"{_COMPILED} is missing: build it by "
            "`cmake -S clients/cpp -B clients/cpp/build && cmake --build clients/cpp/build`"
        )
    alone = _in_time("Without waiting")
    with ExitStack() as loops:
        for _ in range(os.cpu_count() or 1):
            loops.enter_context(_started(_LOOP, os.environ))
        loaded = _in_time("Without waiting, under load", " A busy loop runs for each core.")
    return [alone, loaded, _stopped()]


def _in_time(title: str, also: str = "") -> Table:
    rows = []
    for name, (program, keyed) in _PLAYERS.items():
        for rate in _RATES:
            with _played(program, keyed, rate) as (play, environment, _):
                late = play(int(_SECONDS * rate))
                intervals = np.diff(environment.times)
            off = np.abs(intervals - 1 / rate) * 1000
            share = 100 * late / len(environment.times)
            spread = (f"{np.median(off):.2f}", f"{np.quantile(off, 0.99):.2f}", f"{off.max():.1f}")
            rows.append((name, f"{rate:g}", *spread, f"{1 / np.mean(intervals):.2f}", f"{share:.2f} %"))
    about = (
        f"An agent in a process of its own, over tcp, for {_SECONDS:g} s; the environment, in the hub's "
        "process, shows observations of Mario's size. Off is how far a step's distance from the one before "
        f"differs from a period, in ms.{also}"
    )
    columns = ("player", "rate, Hz", "off, median", "off, 99 %", "off, most", "steps/s", "late")
    return Table(title, about, columns, rows)


def _stopped() -> Table:
    rows = []
    for rate in _RATES:
        with _played(_PROGRAM, False, rate) as (play, environment, pid):
            stopped = threading.Timer(1.0, os.kill, (pid, signal.SIGSTOP))
            continued = threading.Timer(2.0, os.kill, (pid, signal.SIGCONT))
            stopped.start()
            continued.start()
            steps = int(4 * rate)
            late = play(steps)
        rows.append((f"{rate:g}", str(steps), str(len(environment.times)), str(late)))
    about = (
        "The Python player is stopped (SIGSTOP) for one of four seconds: it loses actions, and nothing else."
    )
    return Table(
        "A player that is stopped", about, ("rate, Hz", "steps due", "steps made", "late actions"), rows
    )


@contextmanager
def _played(
    program: Sequence[str], keyed: bool, rate: float
) -> Iterator[tuple[Callable[[int], int], _Timed, int]]:
    """Yield what plays some steps and returns how many were late, the environment, and the player's id."""
    environment = _Timed()
    with tempfile.TemporaryDirectory() as folder:
        own, theirs = new_pair(), new_pair()
        public, _ = write_pair(Path(folder), "hub", own)
        _, secret = write_pair(Path(folder), "player", theirs)
        keys = Keys(own.secret, {theirs.public: Permit("player", frozenset(Role))}) if keyed else None
        config = HubConfig(bind=(Bind("tcp://127.0.0.1:*", keys=keys),), pace=Pace(rate))
        with Hub(config).in_background() as hub:
            variables = {**os.environ, "GLUE_HUB": hub.endpoints[0], "GLUE_SESSION": "0"}
            if keyed:
                variables |= {"GLUE_KEY": str(secret), "GLUE_HUB_KEY": str(public)}
            transport = InsideTransport(hub, {Role.ENVIRONMENT: environment}, "0")
            command = (*program, hub.endpoints[0], "0", "1") if program is _PROGRAM else program
            with connect_over(transport, "0") as glue, _started(command, variables) as pid:
                glue.rl_init(1)

                def play(steps: int) -> int:
                    glue.rl_episode(steps + 1)
                    return hub.sessions.num_late("0")

                yield play, environment, pid


@contextmanager
def _started(program: Sequence[str], variables: Mapping[str, str]) -> Iterator[int]:
    process = subprocess.Popen(program, stderr=subprocess.DEVNULL, env=dict(variables))
    try:
        yield process.pid
    finally:
        process.terminate()
        process.wait()
