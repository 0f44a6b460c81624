"""The runs that the page shows: which there are, and what each comes to in a few words."""

from __future__ import annotations

import hashlib
import os
import time
from collections import deque
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

from experiment_runner.lock import lock_holder
from experiment_runner.plan import REMOTE, RoleSpec
from experiment_runner.report.overview import Overview, overview
from experiment_runner.store.database import DATABASE_FILES
from experiment_runner.store.joined import joined_players
from experiment_runner.store.layout import COMPETITION_FILE, runs_under
from experiment_runner.store.results import Results
from glue.errors import ExperimentError

__all__ = ["Catalog", "Entry"]

_ID_LETTERS: Final = 12
_MOST_NAMES: Final = 20  # of agents, environments and seeds in a line
_RATE_SECONDS: Final = 60.0  # over which the rate of a run is taken
_LEAST_RATE_SECONDS: Final = 2.0


class Entry(NamedTuple):
    """A run: the directory it is in, and its name among the folders that are shown."""

    directory: Path
    name: str


class Catalog:
    """The table of runs. What a browser asks for is looked up here: no path is ever made of what it sends.

    Args:
        folders: runs, and folders of runs, that are shown; one that does not exist yet may come to exist.
    """

    def __init__(self, folders: Sequence[Path]) -> None:
        self._folders = [folder.absolute() for folder in folders]
        self._entries: dict[str, Entry] = {}
        self._seen: dict[str, tuple[object, ...]] = {}
        self._rates: dict[str, _Rate] = {}

    def entry(self, run_id: str) -> Entry:
        """Return a run by its id.

        Raises:
            KeyError: there is no such run.
        """
        return self._entries[run_id]

    def signs(self, run_id: str) -> tuple[object, ...]:
        """Return what is different when a run has changed.

        Raises:
            KeyError: there is no such run.
        """
        return _signs(self._entries[run_id].directory)

    def find(self) -> dict[str, Entry]:
        """Look for runs, and return all that there are, by id."""
        entries: dict[str, Entry] = {}
        for folder in self._folders:
            for directory in runs_under(folder):
                name = str(directory.relative_to(folder.parent))
                entries.setdefault(_id(directory), Entry(directory, _printable(name)))
        self._entries = entries
        return entries

    def changes(self) -> dict[str, dict[str, Any] | None]:
        """Look for runs; return what has changed since the last call: a summary each, None for one gone."""
        entries = self.find()
        changed: dict[str, dict[str, Any] | None] = {}
        for run_id in self._seen.keys() - entries.keys():
            del self._seen[run_id]
            self._rates.pop(run_id, None)
            changed[run_id] = None
        for run_id, entry in entries.items():
            signs = _signs(entry.directory)
            if self._seen.get(run_id) != signs:
                self._seen[run_id] = signs
                changed[run_id] = {"id": run_id, "name": entry.name, **self._summary(run_id, entry.directory)}
        return changed

    def _summary(self, run_id: str, directory: Path) -> dict[str, Any]:
        try:
            with Results.open(directory) as results:
                summary = _summary(results)
        except ExperimentError as error:
            return {"state": "damaged", "reason": _printable(str(error)), "path": str(directory)}
        if summary["state"] == "running":
            rate = self._rates.setdefault(run_id, _Rate())
            rate.add(time.monotonic(), summary["done"])
            left = summary["planned"] - summary["done"]
            summary |= {"rate": rate.rate, "seconds_left": left / rate.rate if rate.rate else None}
        else:
            self._rates.pop(run_id, None)
        return summary


class _Rate:
    """Episodes, or trials of a competition, per second, over the last minute that was watched."""

    def __init__(self) -> None:
        self._points: deque[tuple[float, int]] = deque()

    def add(self, now: float, episodes: int) -> None:
        self._points.append((now, episodes))
        while now - self._points[0][0] > _RATE_SECONDS and len(self._points) > 2:
            self._points.popleft()

    @property
    def rate(self) -> float | None:
        (first, before), (last, after) = self._points[0], self._points[-1]
        seconds = last - first
        return (after - before) / seconds if seconds >= _LEAST_RATE_SECONDS and after > before else None


def _summary(results: Results) -> dict[str, Any]:
    joined = joined_players(results)
    specs = [trial.spec for trial in results.trials()]
    agents = [_label(spec.agent, joined.get((spec.id, "agent"))) for spec in specs]
    environments = [_label(spec.environment, joined.get((spec.id, "environment"))) for spec in specs]
    run = overview(results)
    found = {
        **run.as_json(),
        "path": str(results.directory),
        "agents": _some(agents),
        "environments": _some(environments),
        "competition": (results.directory / COMPETITION_FILE).is_file(),
    }
    if found["competition"]:
        return found | _competition(results, run)
    done, planned = run.episodes
    return found | {"done": done, "planned": planned, "seeds": _some([str(spec.seed) for spec in specs])}


def _competition(results: Results, run: Overview) -> dict[str, Any]:
    """Return what is different for a competition: its trials count, and its seeds are secret."""
    verdicts = [verdict.problem for verdict in results.verdicts().values()]
    over, trials = len(results.outcomes()), run.trials[1]
    return {
        "done": over,
        "planned": trials,
        "verified": verdicts.count(None),
        "mismatched": len(verdicts) - verdicts.count(None),
        # A task of so many steps, or one that is forfeited, never has all episodes of the plan.
        "state": "finished" if over == trials and run.state == "interrupted" else run.state,
    }


def _label(role: RoleSpec | None, joined: str | None) -> str:
    return role.label if role is not None else joined or REMOTE


def _some(names: Sequence[str]) -> list[str]:
    distinct = [_printable(name) for name in dict.fromkeys(names)]
    more = len(distinct) - _MOST_NAMES
    return distinct if more <= 0 else [*distinct[:_MOST_NAMES], f"and {more} more"]


def _signs(directory: Path) -> tuple[object, ...]:
    """Return what is different when a run has changed, at the price of a few system calls."""
    return (lock_holder(directory), *(_version(directory / name) for name in DATABASE_FILES[:2]))


def _version(path: Path) -> tuple[int, int] | None:
    try:
        status = path.stat()
    except OSError:
        return None
    return status.st_mtime_ns, status.st_size


def _id(directory: Path) -> str:
    return hashlib.sha256(os.fsencode(directory)).hexdigest()[:_ID_LETTERS]


def _printable(text: str) -> str:
    """Return a text that can be encoded: a file name may hold any bytes."""
    return text.encode("utf-8", "replace").decode("utf-8")
