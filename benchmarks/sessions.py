"""Steps per second of many sessions on one hub, compared with the previous version."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from functools import partial
from pathlib import Path

from benchmarks.hub import Measure, listening
from benchmarks.measure import Picture, Rate, Table, count, rate, rates, ratio
from benchmarks.players import SIZES, serving
from benchmarks.previous import CHECKOUT, previous_sessions
from glue.client.experiment import connect
from glue.engine.experiment import Experiment

_SESSIONS = (1, 64, 256, 1024)
_COMPARED = 64
_EACH = 100
"""Steps of an episode."""
_TOTAL = 51_200
"""Steps of a measurement, of all sessions together: a short one may fall into a quiet period."""
_EPISODES = 3
"""Minimum episodes of each session: a single one would measure the start and end of many experiments."""
_SMALL, _ = SIZES


def run() -> list[Table]:
    """Measure sessions that all play at once."""
    rows = []
    with ExitStack() as stack:
        measures, memories = [], []
        stack.enter_context(_many_sessions(1))  # one-time needs of a process do not count as a session's
        for number in _SESSIONS:
            before = _resident()
            measures.append(stack.enter_context(_many_sessions(number)))
            memories.append((_resident() - before) / number / 1024)
        if CHECKOUT is not None:
            measures.append(stack.enter_context(previous_sessions(_COMPARED)))
        results = rates(measures)
    if CHECKOUT is not None:
        previous = results.pop().per_second
        now = results[_SESSIONS.index(_COMPARED)].per_second
        rows.append((f"{_COMPARED}, the previous version", count(previous), ratio(previous / now), "", ""))
    for number, result, memory in zip(_SESSIONS, results, memories, strict=True):
        share = ratio(result.per_second / results[_SESSIONS.index(_COMPARED)].per_second)
        cells = count(result.per_second), share, f"{result.cpu:.0f}", f"{memory:.0f} KiB"
        rows.append((f"{number:,}", *cells))
    return [
        Table(
            "Many sessions on one hub",
            f"All over tcp, in episodes of {_EACH} steps: one process serves every agent, one every "
            "environment, one is hub and experiments. Memory is what the last one grew by, its threads "
            f"included (the aim is less than 64 KiB). The aim for {_COMPARED} is 1.3 times the previous "
            f"version, whose checkout GLUE_PREVIOUS names; that for 1,024 is 1.00 of {_COMPARED}.",
            ("sessions", "steps per second in all", f"of {_COMPARED}", "CPU, us", "memory a session"),
            rows,
            Picture(
                "sessions.png",
                "CPU time of a step, and steps per second in all, for one to 1,024 sessions",
                partial(_draw, dict(zip(_SESSIONS, results, strict=True))),
            ),
        )
    ]


def _draw(results: Mapping[int, Rate], path: Path) -> None:
    """Draw how the cost of a step falls, and the number of steps grows, with the number of sessions."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7, 3), dpi=150, layout="constrained")
    cost, speed = figure.subplots(1, 2)
    cost.plot(list(results), [result.cpu for result in results.values()], "o-", color="#0072B2")
    cost.set_ylabel("CPU time of a step, us")
    speed.plot(list(results), [result.per_second for result in results.values()], "o-", color="#D55E00")
    speed.set_ylabel("steps per second in all")
    for axes in (cost, speed):
        axes.set_xscale("log", base=2)
        axes.set_xticks(list(results), [f"{number:,}" for number in results])
        axes.set_xlabel("sessions")
        axes.set_ylim(bottom=0)
        axes.grid(alpha=0.3)
    figure.savefig(path)


def _resident() -> int:
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGESIZE")


@contextmanager
def _many_sessions(number: int) -> Iterator[Measure]:
    with ExitStack() as stack:
        url = stack.enter_context(listening("tcp")).endpoints[0]
        roles = ("environment", "agent")
        pids = [stack.enter_context(serving(role, _SMALL, url, range(number))) for role in roles]
        glues = [stack.enter_context(connect(url, str(i))) for i in range(number)]
        pool = stack.enter_context(ThreadPoolExecutor(number))
        list(pool.map(lambda glue: glue.rl_init(), glues))
        episodes = max(_TOTAL // _EACH // number, _EPISODES)

        def play(glue: Experiment) -> None:
            for _ in range(episodes):
                glue.rl_episode(_EACH)

        yield lambda: rate(lambda: list(pool.map(play, glues)), number * episodes * _EACH, pids)
