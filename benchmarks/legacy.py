"""Steps per second of original programs through the gateway, compared with our own protocol."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager

from benchmarks.measure import Table, count, medians, ratio
from benchmarks.players import SIZES, Still, Walk, serving
from glue.client.experiment import connect
from glue.hub.config import HubConfig, LegacyPort
from glue.hub.io.server import Hub
from glue.legacy.gateway import Gateway
from tests.system.legacy.legacy_client import Connection, OriginalExperiment, play

_STEPS = 5000
_SESSION = "0"
_ADDRESS = "tcp://127.0.0.1:*"


def run() -> list[Table]:
    """Measure original agents, environments and experiments."""
    rows = []
    for size in SIZES:
        with ExitStack() as stack:
            measures = {
                "all ours": stack.enter_context(_ours(size)),
                "original agent and environment": stack.enter_context(_originals(size)),
                "original experiment as well": stack.enter_context(_all_original(size)),
            }
            results = medians(list(measures.values()))
        rows += [
            (name, size, count(value), ratio(value / results[0]))
            for name, value in zip(measures, results, strict=True)
        ]
    return [
        Table(
            "Original programs",
            "Agent, environment and hub in three processes, all over tcp; one RL_episode after the other, "
            "agent and environment doing nothing. The original programs are the test suite's client, in "
            "Python.",
            ("programs", "observation", "steps per second", "times all ours"),
            rows,
        )
    ]


@contextmanager
def _ours(size: str) -> Iterator[Callable[[], float]]:
    with ExitStack() as stack:
        hub = stack.enter_context(Hub(HubConfig(bind=(_ADDRESS,))).in_background())
        url = hub.endpoints[0]
        for role in ("environment", "agent"):
            stack.enter_context(serving(role, size, url))
        glue = stack.enter_context(connect(url, _SESSION))
        glue.rl_init()
        yield lambda: _per_second(lambda: glue.rl_episode(_STEPS))


@contextmanager
def _originals(size: str) -> Iterator[Callable[[], float]]:
    with _gateway(size) as (url, _), connect(url, _SESSION) as glue:
        glue.rl_init()
        yield lambda: _per_second(lambda: glue.rl_episode(_STEPS))


@contextmanager
def _all_original(size: str) -> Iterator[Callable[[], float]]:
    with _gateway(size) as (_, port):
        glue = OriginalExperiment(Connection(port))
        glue.rl_init()
        yield lambda: _per_second(lambda: glue.rl_episode(_STEPS))
        glue.close()


@contextmanager
def _gateway(size: str) -> Iterator[tuple[str, int]]:
    """Yield the URL and the port of a hub that an original agent and environment are about to join."""
    hub = Hub(HubConfig(bind=(_ADDRESS,)))
    (port,) = Gateway(hub, [LegacyPort(0, _SESSION)]).ports
    with hub.in_background():
        command = [sys.executable, "-m", "benchmarks.legacy", str(port.port), size]
        programs = [subprocess.Popen([*command, role]) for role in ("environment", "agent")]
        yield hub.endpoints[0], port.port
    for program in programs:
        program.wait()


def _per_second(episode: Callable[[], object]) -> float:
    began = time.perf_counter()
    episode()
    return _STEPS / (time.perf_counter() - began)


def _main(port: str, size: str, role: str) -> None:
    play(Still() if role == "agent" else Walk(SIZES[size]), Connection(int(port)))


if __name__ == "__main__":
    _main(*sys.argv[1:])
