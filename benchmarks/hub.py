"""Steps per second: in one process, in two, in three, and with many sessions on one hub."""

from __future__ import annotations

import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager

from benchmarks.measure import Table, count, interleaved, ratio
from benchmarks.players import SIZES, Still, Walk, serving
from benchmarks.raw import tcp_round_trips, zmq_round_trips
from glue.client.experiment import connect
from glue.client.players import serve_environment
from glue.core.config import HubConfig
from glue.core.experiment import Experiment
from glue.core.local import local
from glue.hub.server import Hub

__all__ = ["run"]

_STEPS = 5000
_ACTION_SIZE = 20
_SESSIONS = (1, 8, 64)


def run() -> list[Table]:
    """Measure everything about the hub."""
    return [_topologies(), _sessions()]


def _topologies() -> Table:
    rows = []
    for size, observation in SIZES.items():
        body = len(observation.body)
        with ExitStack() as stack:
            measures = {
                "in process": stack.enter_context(_in_process(size)),
                "two processes, ipc": stack.enter_context(_two_processes(size)),
                "three processes, ipc": stack.enter_context(_three_processes(size, "ipc")),
                "three processes, tcp": stack.enter_context(_three_processes(size, "tcp")),
                "raw pyzmq round trips, ipc": stack.enter_context(zmq_round_trips("ipc", body, _ACTION_SIZE)),
                "raw pyzmq round trips, tcp": stack.enter_context(zmq_round_trips("tcp", body, _ACTION_SIZE)),
                "raw TCP round trips": stack.enter_context(tcp_round_trips(body, _ACTION_SIZE)),
            }
            results = dict(zip(measures, interleaved(list(measures.values())), strict=True))
        for name, value in results.items():
            share = ""
            if name.startswith("three"):
                transport = name[-3:]
                share = ratio(value / (results[f"raw pyzmq round trips, {transport}"] / 2))
            rows.append((name, size, count(value), share))
    return Table(
        "Steps per second",
        "One episode after the other, the agent and the environment doing nothing. The last column is the "
        "share of what two raw pyzmq round trips of the same bytes allow, measured in the same run "
        "(the aim is 0.7). Two processes: environment and hub in one, the agent in the other.",
        ("topology", "observation", "per second", "of two raw round trips"),
        rows,
    )


def _sessions() -> Table:
    with ExitStack() as stack:
        measures = [stack.enter_context(_many_sessions(number)) for number in _SESSIONS]
        results = interleaved(measures)
    rows = [
        (str(number), count(value), ratio(value / results[0]))
        for number, value in zip(_SESSIONS, results, strict=True)
    ]
    return Table(
        "Many sessions on one hub",
        "All over tcp: one process serves every agent, one every environment, one is hub and experiments. "
        "The aim is 2.5 times the total of one session with 64.",
        ("sessions", "steps per second in all", "times one"),
        rows,
    )


def _measure(glue: Experiment) -> Callable[[], float]:
    glue.rl_init()

    def measure() -> float:
        began = time.perf_counter()
        glue.rl_episode(_STEPS)
        return _STEPS / (time.perf_counter() - began)

    return measure


@contextmanager
def _in_process(size: str) -> Iterator[Callable[[], float]]:
    with local(Still(), Walk(SIZES[size])) as glue:
        yield _measure(glue)


@contextmanager
def _two_processes(size: str) -> Iterator[Callable[[], float]]:
    with _hub("ipc") as url, serving("agent", size, url):
        environment = threading.Thread(
            target=serve_environment,
            args=(Walk(SIZES[size]), url, "0"),
            kwargs={"log": lambda line: None},
        )
        environment.start()
        with connect(url, "0") as glue:
            yield _measure(glue)
    environment.join()


@contextmanager
def _three_processes(size: str, transport: str) -> Iterator[Callable[[], float]]:
    with ExitStack() as stack:
        url = stack.enter_context(_hub(transport))
        for role in ("environment", "agent"):
            stack.enter_context(serving(role, size, url))
        yield _measure(stack.enter_context(connect(url, "0")))


@contextmanager
def _hub(transport: str) -> Iterator[str]:
    with tempfile.TemporaryDirectory() as folder:
        address = f"ipc://{folder}/hub" if transport == "ipc" else "tcp://127.0.0.1:*"
        with Hub(HubConfig(bind=(address,))).in_background() as hub:
            yield hub.endpoints[0]


@contextmanager
def _many_sessions(number: int) -> Iterator[Callable[[], float]]:
    size = next(iter(SIZES))
    with ExitStack() as stack:
        url = stack.enter_context(_hub("tcp"))
        for role in ("environment", "agent"):
            stack.enter_context(serving(role, size, url, number))
        glues = [stack.enter_context(connect(url, str(i))) for i in range(number)]
        pool = stack.enter_context(ThreadPoolExecutor(number))
        list(pool.map(lambda glue: glue.rl_init(), glues))
        steps = max(_STEPS // number, 200)

        def measure() -> float:
            began = time.perf_counter()
            list(pool.map(lambda glue: glue.rl_episode(steps), glues))
            return number * steps / (time.perf_counter() - began)

        yield measure
