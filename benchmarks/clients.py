"""The client libraries: steps per second and memory of an agent and of an environment in each language."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from functools import partial
from pathlib import Path

from benchmarks.measure import REPEATS, Rate, Table, count, rate, rates, ratio
from glue import connect
from glue.engine.experiment import Experiment
from glue.hub.config import HubConfig
from glue.hub.io.server import Hub

_ROOT = Path(__file__).parent.parent
_CLIENTS = _ROOT / "clients"
_STEPS = 4000
_WARM_UP = 12_000
"""Steps before the first measurement: a client is slow until V8 has compiled it, after some 8,000."""
_LATER = 50_000
_AGENT = "from tests.clients.random_agent import RandomAgent; glue.serve_agent(RandomAgent())"
_ENVIRONMENT = (
    "from env_server.toys import SkeletonEnvironment; glue.serve_environment(SkeletonEnvironment())"
)
_JAVA_PATH = f"{_CLIENTS / 'java/build/glue-rl.jar'}:{_CLIENTS / 'java/build/examples'}"
_JAVA = ("java", "-XX:+UseSerialGC", "-XX:TieredStopAtLevel=1", "-cp", _JAVA_PATH)
"""With the flags of clients/java/README.md: without them the compiler is busier than the agent."""

_LANGUAGES: dict[str, dict[str, Sequence[str]]] = {
    "Python": {
        "random": (sys.executable, "-c", f"import glue; {_AGENT}"),
        "skeleton": (sys.executable, "-c", f"import glue; {_ENVIRONMENT}"),
    },
    "C++": {each: (str(_CLIENTS / "cpp/build" / each),) for each in ("random", "skeleton")},
    "Java": {"random": (*_JAVA, "RandomAgent"), "skeleton": (*_JAVA, "Skeleton")},
    "JavaScript": {
        each: ("node", str(_CLIENTS / "javascript/examples" / f"{each}.js"))
        for each in ("random", "skeleton")
    },
    "Rust": {
        each: (str(_CLIENTS / "rust/target/release/examples" / each),) for each in ("random", "skeleton")
    },
}


def run() -> list[Table]:
    """Return the table of the languages whose examples have been built."""
    built = {name: programs for name, programs in _LANGUAGES.items() if _is_built(programs["random"])}
    missing = [name for name in _LANGUAGES if name not in built]
    if missing:
        print(f"not built, and so left out: {', '.join(missing)} (see clients/)", file=sys.stderr)
    with ExitStack() as stack:
        cases = [
            (name, transport, *stack.enter_context(_playing(programs, transport)))
            for name, programs in built.items()
            for transport in ("ipc", "tcp")
        ]
        for _, _, glue, _ in cases:
            _play(glue, _WARM_UP)
        early = {name: _resident(pids[0]) for name, _, _, pids in cases}
        results = rates([partial(_rate, glue, pids) for _, _, glue, pids in cases])
        for _, transport, glue, _ in cases:
            if transport == "tcp":
                _play(glue, _LATER - _WARM_UP - REPEATS * _STEPS)
        late = {name: _resident(pids[0]) for name, _, _, pids in cases}
    measured = {case[:2]: result for case, result in zip(cases, results, strict=True)}
    rows = []
    for name in built:
        ipc, tcp = measured[name, "ipc"], measured[name, "tcp"]
        shares = [
            ratio(one.per_second / measured["Python", transport].per_second)
            for one, transport in ((ipc, "ipc"), (tcp, "tcp"))
        ]
        speeds = count(ipc.per_second), count(tcp.per_second), f"{ipc.cpu:.0f}", f"{tcp.cpu:.0f}"
        rows.append((name, *shares, *speeds, f"{early[name]:.1f}", f"{late[name]:.1f}"))
    about = (
        "Agent and environment are the examples of one client library (a random agent in RL-Glue's walk), "
        "in a process each; hub and experiment are ours, in a third. The aim of a compiled language is 1.00 "
        "of Python. CPU time is that of all three processes. Memory is what the agent over tcp has resident "
        f"after {_WARM_UP:,} steps, and after {_LATER:,}."
    )
    columns = (
        *("language", "of Python, ipc", "of Python, tcp", "steps/s, ipc", "steps/s, tcp"),
        *("CPU us, ipc", "CPU us, tcp", "MB", "MB later"),
    )
    return [Table("Client libraries", about, columns, rows)]


def _is_built(command: Sequence[str]) -> bool:
    paths = [part for word in command for part in word.split(":") if str(_CLIENTS) in part]
    return all(Path(path).exists() for path in paths)


@contextmanager
def _playing(programs: dict[str, Sequence[str]], transport: str) -> Iterator[tuple[Experiment, list[int]]]:
    """Yield an experiment that has begun, and the processes of its agent and its environment."""
    with tempfile.TemporaryDirectory() as folder:
        hub = Hub(HubConfig(bind=(f"ipc://{folder}/hub" if transport == "ipc" else "tcp://127.0.0.1:*",)))
        url = hub.endpoints[0]
        place = {**os.environ, "GLUE_HUB": url}
        players = [
            subprocess.Popen(command, env=place, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
            for command in programs.values()
        ]
        try:
            with hub.in_background(), connect(url) as glue:
                glue.rl_init(1)
                yield glue, [player.pid for player in players]
        finally:
            for player in players:
                player.kill()
                player.wait()


def _rate(glue: Experiment, pids: Sequence[int]) -> Rate:
    return rate(lambda: _play(glue, _STEPS), _STEPS, pids)


def _play(glue: Experiment, steps: int) -> None:
    """Play episodes of at least `steps` steps in all."""
    while steps > 0:
        glue.rl_episode(steps)
        steps -= glue.rl_num_steps()


def _resident(pid: int) -> float:
    """Return the resident memory of a process in megabytes."""
    pages = int(Path(f"/proc/{pid}/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6
