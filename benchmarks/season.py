"""A season under load: 1,000 have enrolled, 200 ask for attempts again and again, 10 play, 30 look on."""

from __future__ import annotations

import http.client
import re
import secrets
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from datetime import datetime
from hashlib import sha256
from pathlib import Path
from typing import Final, NamedTuple

from nacl.public import PrivateKey

from benchmarks.measure import Table, count
from experiment_runner.competition.organiser import open_competition
from experiment_runner.competition.records.journal import ENROL, OVER, START, act, acts_of
from experiment_runner.competition.records.seal import record_acts
from experiment_runner.competition.settings import parse_competition
from glue.client.players import serve_agent
from glue.client.season import Membership, Season
from glue.client.target import Target
from glue.errors import GlueError
from glue.keys.certificates import KeyPair, encode, write_pair
from glue.types import Action, Observation

_ENROLLED: Final = 1000
_CONNECTED: Final = 200
_PLAYING: Final = 10
_PAGES: Final = 30
_MINUTES: Final = 30
_WINDOW_SECONDS: Final = 150.0
"""Time with pages, and then without."""

_POLL_SECONDS: Final = 5.0
"""Interval of an open page, as in static/season/data.js."""

_THINK_SECONDS: Final = 0.05
_PORT: Final = 24_097
_PAGE_PORT: Final = _PORT + _PLAYING

_FILE: Final = f"""\
seed_file = "secret"
[season]
opens = 2020-01-01T00:00:00
closes = 2100-01-01T00:00:00
enrol = "closed"
attempts_per_day = 1_000_000
parallel = {_PLAYING}
[tasks.mines]
env = "mines"
phase = "proving"
steps = 200
"""


class _Sample(NamedTuple):
    """CPU time in seconds and memory in bytes, of the server and of the page's process."""

    time: float
    cpu: tuple[float, float]
    memory: tuple[int, int]


class _Thinker:
    def agent_start(self, observation: Observation) -> Action:
        return self._act()

    def agent_step(self, reward: float, observation: Observation) -> Action:
        return self._act()

    def _act(self) -> Action:
        time.sleep(_THINK_SECONDS)
        return Action(ints=[0])


def run() -> list[Table]:
    """Measure a season for half an hour."""
    with tempfile.TemporaryDirectory() as made:
        folder = Path(made)
        hub_key = _prepare(folder)
        with _served(folder) as processes:
            for number in range(_CONNECTED):
                threading.Thread(target=_connected, args=(folder, number, hub_key), daemon=True).start()
            samples, latencies, windows = _watch(processes, folder / "run")
        return [_table(samples, latencies, windows, folder / "run")]


def _prepare(folder: Path) -> str:
    """Make a season in which everybody has enrolled; return the public key of its hub."""
    (folder / "secret").write_text("only a benchmark")
    (folder / "file.toml").write_text(_FILE)
    hub = _pair()
    (folder / "keys").mkdir()
    write_pair(folder / "keys", "hub", hub)
    competition = parse_competition(_FILE, folder / "file.toml")
    acts = []
    for number in range(_ENROLLED):
        pair, name = _pair(), f"entrant{number}"
        if number < _CONNECTED:
            write_pair(folder, name, pair)
        token = sha256(name.encode()).hexdigest()
        acts.append(
            act(
                ENROL,
                name,
                "",
                player=f"{name}.pub",
                id=encode(pair.public),
                alias=f"mole {number}",
                token=token,
            )
        )
    with open_competition(folder / "run", _FILE, competition, b"only a benchmark") as store:
        record_acts(store, acts)
    return encode(hub.public)


def _pair() -> KeyPair:
    key = PrivateKey(secrets.token_bytes(32))
    return KeyPair(bytes(key.public_key), bytes(key))


@contextmanager
def _served(folder: Path) -> Iterator[tuple[int, int]]:
    """Serve the season; yield the ids of the server's process and of the page's."""
    command = [
        sys.executable,
        "-m",
        "glue_rl",
        "compete",
        "serve",
        "file.toml",
        "--out",
        "run",
        "--keys",
        "keys",
    ]
    command += ["--bind", f"tcp://127.0.0.1:{_PORT}", "--page", f"127.0.0.1:{_PAGE_PORT}"]
    with (folder / "log").open("wb") as log, subprocess.Popen(command, cwd=folder, stderr=log) as server:
        try:
            while _latency("/season.json") is None:
                assert server.poll() is None, (folder / "log").read_text()
                time.sleep(0.5)
            (page,) = (child for child in _children(server.pid) if "page" in _words(child))
            yield server.pid, page
        finally:
            server.terminate()


def _connected(folder: Path, number: int, hub_key: str) -> None:
    """Ask for attempts and play them, for ever."""
    name = f"entrant{number}"
    key = folder / f"{name}.key_secret"
    season = Season(Membership(f"http://127.0.0.1:{_PAGE_PORT}", name, key, hub_key, ""))

    def serve(target: Target, on: Callable[[], bool]) -> None:
        with suppress(GlueError):
            serve_agent({name: _Thinker()}, target.hub, key=key, hub_key=hub_key, wait=10.0)

    while True:
        with suppress(GlueError, OSError):
            season.play(serve, lambda line: None)


def _watch(
    processes: tuple[int, int], directory: Path
) -> tuple[list[_Sample], list[float], list[tuple[bool, float]]]:
    """Return samples, latencies of pages, and an attempt's CPU time in windows with and without pages."""
    samples = [_sample(processes)]
    latencies: list[float] = []
    windows: list[tuple[bool, float]] = []
    began = time.monotonic()
    while time.monotonic() - began < 60 * _MINUTES:
        for pages in (0, _PAGES):
            before, until = _played(processes[0], directory), time.monotonic() + _WINDOW_SECONDS
            threads = [
                threading.Thread(target=_page, args=(until, latencies), daemon=True) for _ in range(pages)
            ]
            for thread in threads:
                thread.start()
                time.sleep(_POLL_SECONDS / _PAGES)
            time.sleep(max(0.0, until - time.monotonic()))
            for thread in threads:
                thread.join()
            used, over = (
                now - was for now, was in zip(_played(processes[0], directory), before, strict=True)
            )
            windows.append((pages > 0, used / over))
            samples.append(_sample(processes))
    return samples, latencies, windows


def _page(until: float, latencies: list[float]) -> None:
    while time.monotonic() < until:
        if (seconds := _latency("/season.json")) is not None:
            latencies.append(seconds)
        time.sleep(_POLL_SECONDS)


def _latency(path: str) -> float | None:
    """Return how long the page takes to answer; None if it does not."""
    began = time.monotonic()
    connection = http.client.HTTPConnection("127.0.0.1", _PAGE_PORT, timeout=60)
    try:
        connection.request("GET", path)
        connection.getresponse().read()
    except (OSError, http.client.HTTPException):
        return None
    finally:
        connection.close()
    return time.monotonic() - began


def _over(directory: Path) -> int:
    return sum(one.act == OVER for one in acts_of(directory))


def _played(server: int, directory: Path) -> tuple[float, int]:
    """Return the CPU time in seconds of all matches and replays so far, and the number of attempts."""
    workers = [child for child in _children(server) if "experiment_runner.processes.warm" in _words(child)]
    return sum(_cpu(child, 15) for child in workers), _over(directory)


def _cpu(process: int, end: int = 13) -> float:
    """Return the CPU time of a process in seconds; with an `end` of 15, also of its children that ended."""
    fields = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    return sum(map(int, fields[11:end])) / 100


def _sample(processes: tuple[int, int]) -> _Sample:
    cpu, memory = [], []
    for process in processes:
        cpu.append(_cpu(process))
        found = re.search(r"VmRSS:\s+(\d+)", Path(f"/proc/{process}/status").read_text())
        assert found is not None
        memory.append(int(found[1]) * 1024)
    return _Sample(time.monotonic(), (cpu[0], cpu[1]), (memory[0], memory[1]))


def _children(process: int) -> list[int]:
    return [int(child) for child in Path(f"/proc/{process}/task/{process}/children").read_text().split()]


def _words(process: int) -> list[str]:
    return Path(f"/proc/{process}/cmdline").read_text().split("\0")


def _idle(directory: Path) -> float:
    """Return the mean time in seconds that a slot is empty before an attempt."""
    acts = [one for one in acts_of(directory) if one.act in (START, OVER)]
    moments = [(datetime.fromisoformat(one.time).timestamp(), one.act) for one in acts]
    playing = busy = 0.0
    last = moments[0][0]
    for moment, kind in moments:
        busy += playing * (moment - last)
        playing += 1 if kind == START else -1
        last = moment
    starts = sum(kind == START for _, kind in moments)
    return (_PLAYING * (last - moments[0][0]) - busy) / starts


def _table(
    samples: list[_Sample], latencies: list[float], windows: list[tuple[bool, float]], directory: Path
) -> Table:
    first, last = samples[1], samples[-1]
    minutes = (last.time - first.time) / 60
    used = [(after - before) / (60 * minutes) for before, after in zip(first.cpu, last.cpu, strict=True)]
    alone, watched = (
        statistics.median(used for is_open, used in windows if is_open is which) for which in (False, True)
    )
    ordered = sorted(latencies)
    mib = [
        [round(one.memory[i] / 2**20) for one in (samples[1], samples[len(samples) // 2], last)]
        for i in (0, 1)
    ]
    return Table(
        "A season",
        f"{_ENROLLED:,} have enrolled, {_CONNECTED} ask for attempts again and again, {_PLAYING} play at "
        f"once, each for about {200 * _THINK_SECONDS:g} s; {_MINUTES} minutes, in half of which {_PAGES} "
        "pages are open. An attempt's start is late by the time that its slot was empty before, in which its "
        "program has to ask, too.",
        ("", ""),
        [
            ("attempts over", count(_over(directory))),
            (
                "a page's answer, median, 99 % (ms)",
                f"{1000 * statistics.median(ordered):.0f}, {1000 * ordered[int(0.99 * len(ordered))]:.0f}",
            ),
            ("an attempt's start is late by (s)", f"{_idle(directory):.1f}"),
            ("CPU of the server and of the page (cores)", f"{used[0]:.2f}, {used[1]:.2f}"),
            ("memory of the server: first, middle, end (MiB)", ", ".join(map(str, mib[0]))),
            ("memory of the page (MiB)", ", ".join(map(str, mib[1]))),
            (
                "CPU of the matches of an attempt, without and with open pages (s)",
                f"{alone:.3f}, {watched:.3f}",
            ),
        ],
    )
