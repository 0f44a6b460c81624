"""The cost of open pages to a run, and of a page that shows a game: steps per second with and without."""

from __future__ import annotations

import http.client
import json
import re
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager, suppress
from pathlib import Path
from typing import Final

from benchmarks.measure import REPEATS, Table, count
from experiment_runner.store.results import Results
from glue.errors import ExperimentError

_PAGES: Final = 20
_SECONDS: Final = 6.0
"""Duration of each measurement."""
_SETTLE_SECONDS: Final = 1.0
_REFRESH_SECONDS: Final = 2.0
"""Interval between fetches, as in static/curves.js."""
_GAME_SECONDS: Final = 8.0
_GAME_TURNS: Final = 11
"""Number of turns: steps are counted when an episode ends, which makes a short measurement 2 % wrong."""
_COMMAND: Final = ("--env", "mario", "--agent", "random", "--episodes", "1000000", "--out", "runs/run")


def run() -> list[Table]:
    """Measure a run at full speed with and without pages, in turn."""
    return [_pages(), _game()]


def _pages() -> Table:
    with _running("--in-process") as folder:
        alone, watched, fetched = _measure(folder)
    medians = statistics.median(alone), statistics.median(watched)
    lost = statistics.median(1 - one / other for one, other in zip(watched, alone, strict=True))
    return Table(
        "Pages that are open",
        f"`glue-view` with {_PAGES} pages open on a run of the random agent in Infinite Mario, in one "
        "process at full speed: each takes in the stream, and fetches the curves every "
        f"{_REFRESH_SECONDS:g} seconds, as the page does. Medians of {REPEATS} measurements of "
        f"{_SECONDS:g} seconds each, with and without pages in turn; the loss is the median of that of "
        "each pair (the aim is 5 %). The pages share the processors with run and server.",
        ("pages", "steps per second", "lost"),
        [
            ("none", count(medians[0]), ""),
            (f"{_PAGES} ({fetched} curves fetched)", count(medians[1]), f"{100 * lost:.1f} %"),
        ],
    )


def _game() -> Table:
    """Measure a run at a hub: without a server, with a server but no page, and with a page of the game."""
    rates: list[tuple[float, float, float]] = []
    with _running() as folder:
        directory = folder / "runs" / "run"
        for _ in range(_GAME_TURNS):
            alone = _rate(directory, _GAME_SECONDS)
            with _served(folder) as (port, cookie):
                unseen = _rate(directory, _GAME_SECONDS)
                page = _Page(port, cookie, f"live:{_run_id(port, cookie)}")
                rates.append((alone, unseen, _rate(directory, _GAME_SECONDS)))
                page.close()
    medians = [statistics.median(column) for column in zip(*rates, strict=True)]
    lost = [statistics.median(1 - one[i] / one[0] for one in rates) for i in (1, 2)]
    return Table(
        "A game that is looked at",
        "The random agent in Infinite Mario as three processes with a hub, at full speed. Who looks on is "
        f"shown at most 30 moments a second. Medians of {_GAME_TURNS} measurements of {_GAME_SECONDS:g} "
        "seconds each, in turn; the loss is the median of that of each turn (the aim is 2 % where nobody "
        "looks).",
        ("who looks on", "steps per second", "lost"),
        [
            ("nobody, and no page is served", count(medians[0]), ""),
            ("nobody", count(medians[1]), f"{100 * lost[0]:.1f} %"),
            ("a page", count(medians[2]), f"{100 * lost[1]:.1f} %"),
        ],
    )


@contextmanager
def _running(*options: str) -> Iterator[Path]:
    """Yield a folder with a run in progress."""
    with tempfile.TemporaryDirectory() as made:
        command = [sys.executable, "-m", "glue_rl", "experiment", *_COMMAND, *options]
        quiet = subprocess.DEVNULL
        with subprocess.Popen(command, cwd=made, stdout=quiet, stderr=quiet) as process:
            try:
                while not _has_begun(Path(made) / "runs" / "run"):
                    time.sleep(0.1)
                yield Path(made)
            finally:
                process.terminate()


def _measure(folder: Path) -> tuple[list[float], list[float], int]:
    directory = folder / "runs" / "run"
    alone, watched, fetched = [], [], 0
    with _served(folder) as (port, cookie):
        for _ in range(REPEATS):
            alone.append(_rate(directory))
            pages = [_Page(port, cookie) for _ in range(_PAGES)]
            watched.append(_rate(directory))
            fetched += sum(page.close() for page in pages)
    return alone, watched, fetched


def _has_begun(directory: Path) -> bool:
    try:
        return _steps(directory) > 0
    except ExperimentError:  # the run is still being created
        return False


def _rate(directory: Path, seconds: float = _SECONDS) -> float:
    time.sleep(_SETTLE_SECONDS)
    steps, began = _steps(directory), time.monotonic()
    time.sleep(seconds)
    return (_steps(directory) - steps) / (time.monotonic() - began)


def _steps(directory: Path) -> int:
    with Results.open(directory) as results:
        (trial,) = results.trials()
        return results.totals(trial.spec.id).steps


@contextmanager
def _served(folder: Path) -> Iterator[tuple[int, str]]:
    """Start a `glue-view`; yield its port, and the cookie that opens it."""
    command = [sys.executable, "-m", "glue_rl", "view", "--port", "0", "--no-browser"]
    with subprocess.Popen(command, cwd=folder, stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            found = re.search(r":(\d+)(/\?token=\S+)", process.stdout.readline())
            assert found is not None
            with closing(http.client.HTTPConnection("127.0.0.1", int(found[1]))) as connection:
                connection.request("GET", found[2])
                cookie = connection.getresponse().headers["Set-Cookie"].partition(";")[0]
            yield int(found[1]), cookie
        finally:
            process.terminate()


def _run_id(port: int, cookie: str) -> str:
    with closing(http.client.HTTPConnection("127.0.0.1", port)) as connection:
        connection.request("GET", "/api/stream?topic=runs", headers={"Cookie": cookie})
        events = connection.getresponse()
        while not (line := events.readline()).startswith(b"data: "):
            pass
        (found,) = json.loads(line[6:])["runs"]
        return str(found)


class _Page:
    """A page of the run's curves, with the requests of static/stream.js and static/curves.js at their rate,
    or a page of its game."""

    def __init__(self, port: int, cookie: str, topic: str = "runs") -> None:
        self._port = port
        self._headers = {"Cookie": cookie}
        self._fetched = 0
        self._stream = http.client.HTTPConnection("127.0.0.1", port)
        self._stream.request("GET", f"/api/stream?topic={topic}", headers=self._headers)
        self._events = self._stream.getresponse()
        self._thread = threading.Thread(target=self._look, daemon=True)
        self._thread.start()

    def close(self) -> int:
        """Close the page; return the number of times that it has fetched the curves."""
        with suppress(OSError):
            self._stream.sock.shutdown(2)
        self._thread.join()
        return self._fetched

    def _look(self) -> None:
        last = -_REFRESH_SECONDS
        with suppress(OSError, ValueError, http.client.HTTPException):
            while line := self._events.readline():
                if line.startswith(b'data: {"runs"') and time.monotonic() - last >= _REFRESH_SECONDS:
                    (run_id,) = json.loads(line[6:])["runs"]
                    last = time.monotonic()
                    self._fetch(run_id)

    def _fetch(self, run_id: str) -> None:
        with closing(http.client.HTTPConnection("127.0.0.1", self._port)) as connection:
            connection.request("GET", f"/api/curves?run={run_id}&window=100", headers=self._headers)
            answer = connection.getresponse()
            answer.read()
            assert answer.status == 200
            self._fetched += 1
