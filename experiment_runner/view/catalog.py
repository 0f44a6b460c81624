"""The runs that the page shows: a table with a summary, the note and the tags of each; and each in full."""

from __future__ import annotations

import asyncio
import hashlib
import json
import math
import os
import time
from collections import deque
from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any, Final, NamedTuple

from experiment_runner.competition.board.forms import LEGEND, as_json
from experiment_runner.competition.board.standings import standings
from experiment_runner.competition.course import course_of
from experiment_runner.plan.plan import TrialSpec
from experiment_runner.report.overview import Overview, as_object, overview
from experiment_runner.store import layout
from experiment_runner.store.database import DATABASE_FILES
from experiment_runner.store.layout import lock_holder
from experiment_runner.store.results import Results
from experiment_runner.view.export import figures
from experiment_runner.view.stream import Pulse, Reader, Topic
from glue.console import one_line, printable
from glue.errors import ExperimentError
from glue.files import read_regular

NOTES_LIMIT: Final = 16_384
"""Maximum size of a run's notes in bytes."""

_MOST_NOTE: Final = 4000  # characters
_MOST_TAGS: Final = 20
_MOST_TAG: Final = 40  # characters

_ID_LETTERS: Final = 12

# Of the table
_MOST_NAMES: Final = 20  # of agents, environments and values of an option in a line
_MOST_OPTIONS: Final = 50  # that are listed
_LAST: Final = 100  # episodes of a trial, of which the mean return is shown
_MOST_RETURNS: Final = 500  # trials whose returns are read
_RATE_SECONDS: Final = 60.0  # over which the rate of a run is taken
_LEAST_RATE_SECONDS: Final = 2.0
_WATCH_SECONDS: Final = 1.0
_REST: Final = 20  # seconds between scans for runs, for each second that a scan takes

# Of a run in full
_MOST_ROWS: Final = 200  # voids and events, the newest; answers
_MOST_TRIALS: Final = 1000
_MOST_ANSWER: Final = 2000  # characters
_MOST_BYTES: Final = 2**20  # of a text file


class Entry(NamedTuple):
    """A run: its directory, and its name among the folders that are shown."""

    directory: Path
    name: str


class Catalog:
    """The table of runs. Ids from a browser are looked up here: no path is ever made from a request.

    Args:
        folders: runs, and folders of runs, that are shown; one that does not exist yet may appear later.
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
        """Return a value that differs when a run has changed.

        Raises:
            KeyError: there is no such run.
        """
        return _signs(self._entries[run_id].directory)

    def find(self) -> dict[str, Entry]:
        """Scan for runs, and return all of them by id."""
        entries: dict[str, Entry] = {}
        for folder in self._folders:
            for directory in layout.runs_under(folder):
                name = str(directory.relative_to(folder.parent))
                entries.setdefault(run_id(directory), Entry(directory, name))
        self._entries = entries
        return entries

    def changes(self) -> dict[str, dict[str, Any] | None]:
        """Scan for runs; return a summary of each run changed since the last call, None for a removed one."""
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
            summary |= read_notes(directory)
        except ExperimentError as error:
            return {"state": "damaged", "reason": str(error), "path": str(directory)}
        if summary["state"] == "running":
            rate = self._rates.setdefault(run_id, _Rate())
            rate.add(time.monotonic(), summary["done"])
            left = summary["planned"] - summary["done"]
            summary |= {"rate": rate.rate, "seconds_left": left / rate.rate if rate.rate else None}
        else:
            self._rates.pop(run_id, None)
        return summary


class Watcher:
    """Keeps the topic `runs` up to date, as long as at least one page listens to it."""

    def __init__(self, catalog: Catalog, pulse: Pulse) -> None:
        self._catalog = catalog
        self._topic = Topic(pulse)
        self._read = Reader("watcher")
        self._listeners = 0
        self._task: asyncio.Task[None] | None = None

    @asynccontextmanager
    async def open(self, argument: str) -> AsyncIterator[Topic]:
        """Yield the topic; see `experiment_runner.view.stream.Source`."""
        if argument:
            raise KeyError(argument)
        self._listeners += 1
        try:
            if self._task is None:
                await self._look()
                self._task = asyncio.create_task(self._watch())
            yield self._topic
        finally:
            self._listeners -= 1
            if not self._listeners and self._task is not None:
                self._task.cancel()
                self._task = None

    async def _watch(self) -> None:
        while True:
            began = time.monotonic()
            await self._look()
            took = time.monotonic() - began
            await asyncio.sleep(max(_WATCH_SECONDS, _REST * took))

    async def _look(self) -> None:
        # The catalog reports a change once: it must not be lost if the last page leaves meanwhile.
        await asyncio.shield(asyncio.create_task(self._take_changes()))

    async def _take_changes(self) -> None:
        changes = await self._read(self._catalog.changes)
        for run_id, summary in changes.items():
            self._topic.put(run_id, summary)


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
    joined = results.joined_players()
    specs = [trial.spec for trial in results.trials()]
    labels = [spec.labels(joined) for spec in specs]
    run = overview(results)
    found = {
        **run.as_json(),
        "path": str(results.directory),
        "agents": _some([label["agent"] for label in labels]),
        "environments": _some([label["environment"] for label in labels]),
        "competition": (results.directory / layout.COMPETITION_FILE).is_file(),
    }
    if found["competition"]:
        return found | _competition(results, run)
    done, planned = run.steps if run.steps[1] else run.episodes
    numbers = {"returns": _returns(results, specs), "options": _options(specs)}
    return found | {"done": done, "planned": planned, **numbers}


def _returns(results: Results, specs: Sequence[TrialSpec]) -> list[float]:
    """Return the mean return of each setting: of the last episodes of its trials so far."""
    found: dict[str, list[float]] = {}
    for spec in specs[:_MOST_RETURNS]:
        last = results.totals(spec.id, _LAST)
        if last.episodes and math.isfinite(last.sum_of_returns):
            found.setdefault(repr((spec.agent, spec.environment)), []).append(
                last.sum_of_returns / last.episodes
            )
    of_settings = [sum(means) / len(means) for means in found.values()]  # which may exceed all numbers
    return [*filter(math.isfinite, of_settings)][:_MOST_NAMES]


def _options(specs: Sequence[TrialSpec]) -> dict[str, list[str]]:
    """Return the values of each option of the run's agents and environments."""
    found: dict[str, dict[str, None]] = {}
    for spec in specs:
        for role in (spec.environment, spec.agent):
            for name, value in (role.options if role is not None else {}).items():
                if name in found or len(found) < _MOST_OPTIONS:
                    found.setdefault(name, {})[str(value)] = None
    return {name: _some(list(values)) for name, values in found.items()}


def read_notes(directory: Path) -> dict[str, Any]:
    """Return a run's `note` and `tags`, which may come from anyone: within limits, or empty."""
    try:
        return checked_notes(read_regular(directory / layout.NOTES_FILE, NOTES_LIMIT))
    except (OSError, ExperimentError):
        return {"note": "", "tags": []}


def checked_notes(content: bytes) -> dict[str, Any]:
    """Return a note and tags from JSON.

    Raises:
        ExperimentError: it has another form, or is too long.
    """
    try:
        found = json.loads(content)
        note, tags = printable(found["note"]), [one_line(tag) for tag in found["tags"]]
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError):
        raise ExperimentError('notes are JSON: {"note": "text", "tags": ["word"]}') from None
    tags = [tag for tag in dict.fromkeys(tags) if tag]
    if len(note) > _MOST_NOTE or len(tags) > _MOST_TAGS or any(len(tag) > _MOST_TAG for tag in tags):
        raise ExperimentError(
            f"a note has at most {_MOST_NOTE} characters, and a run {_MOST_TAGS} tags of {_MOST_TAG}"
        )
    return {"note": note, "tags": tags}


def write_notes(directory: Path, notes: dict[str, Any]) -> None:
    """Store a run's note and tags, in its file `notes.json`.

    Raises:
        ExperimentError: the file cannot be written.
    """
    layout.replace_flushed(directory / layout.NOTES_FILE, json.dumps(notes) + "\n")


def _competition(results: Results, run: Overview) -> dict[str, Any]:
    """Return the fields that a competition replaces: it counts trials, not episodes."""
    verdicts = [verdict.problem for verdict in results.verdicts().values()]
    over, trials = len(results.outcomes()), run.trials[1]
    return {
        "done": over,
        "planned": trials,
        "verified": verdicts.count(None),
        "mismatched": len(verdicts) - verdicts.count(None),
        # A task with a number of steps, or a forfeited one, never has all episodes of the plan.
        "state": "finished" if over == trials and run.state == "interrupted" else run.state,
    }


def run_in_full(directory: Path) -> dict[str, Any]:
    """Return everything that is known of a run, except its episodes.

    Raises:
        ExperimentError: the run cannot be read.
    """
    with Results.open(directory) as results:
        found: dict[str, Any] = as_object(results)
    for name, most in (("voids", _MOST_ROWS), ("events", _MOST_ROWS)):
        found[name + "_left_out"] = max(0, len(found[name]) - most)
        found[name] = found[name][-most:]
    for name, most in (("trial_records", _MOST_TRIALS), ("answers", _MOST_ROWS)):
        found[name + "_left_out"] = max(0, len(found[name]) - most)
        found[name] = found[name][:most]
    for answered in found["answers"]:
        answered["answer"] = answered["answer"][:_MOST_ANSWER]
    competition = _text(directory / layout.COMPETITION_FILE)
    for trial in found["trial_records"]:
        # As text, since JavaScript would round it; in a competition it is secret.
        trial["seed"] = "secret" if competition else str(trial["seed"])
    return found | {
        "plan": competition or _text(directory / layout.PLAN_FILE),
        "competition": bool(competition),
        "about": _about(_text(directory / layout.ABOUT_FILE)),
    }


def standings_of(directory: Path) -> dict[str, Any]:
    """Return the board of a competition and its progress, but nothing of the secret seed.

    Raises:
        ExperimentError: the directory holds no competition, or cannot be read.
    """
    with Results.open(directory) as results:
        course = course_of(directory)
        found = standings(results, course)
        board: dict[str, Any] = json.loads(as_json(found))
        over = results.outcomes()
        progress = {"matches": len(course.trials), "over": sum(trial in over for trial in course.trials)}
        return board | progress | {"legend": LEGEND, "figures": figures(found)}


def _about(text: str) -> dict[str, Any]:
    try:
        # A number that JSON lacks, or one too large to be read, is kept as text.
        about = json.loads(text, parse_constant=str, parse_float=_finite)
        json.dumps(about)
    except (ValueError, RecursionError):
        return {}
    return about if isinstance(about, dict) else {}


def _finite(text: str) -> float | str:
    return float(text) if math.isfinite(float(text)) else text


def _text(path: Path) -> str:
    """Return the contents of a text file; empty if it cannot be read, or should not."""
    try:
        return read_regular(path, _MOST_BYTES).decode("utf-8", "replace")
    except OSError:
        return ""


def _some(names: Sequence[str]) -> list[str]:
    distinct = [*dict.fromkeys(names)]
    more = len(distinct) - _MOST_NAMES
    return distinct if more <= 0 else [*distinct[:_MOST_NAMES], f"and {more} more"]


def _signs(directory: Path) -> tuple[object, ...]:
    """Return a value that differs when a run has changed, at the price of a few system calls."""
    names = (*DATABASE_FILES[:2], layout.NOTES_FILE)
    return (lock_holder(directory), *(version(directory / name) for name in names))


def version(path: Path) -> tuple[int, int] | None:
    """Return a value that differs when a file has changed; None if it cannot be seen."""
    try:
        status = path.stat()
    except OSError:
        return None
    return status.st_mtime_ns, status.st_size


def address_of(folders: Sequence[Path]) -> str:
    """Return the end of the page's address for a run, a competition (its standings), or all runs."""
    if len(folders) != 1 or not (folders[0] / DATABASE_FILES[0]).is_file():
        return ""
    view = "standings" if (folders[0] / layout.COMPETITION_FILE).is_file() else "run"
    return f"#/{view}/{run_id(folders[0].absolute())}"


def run_id(directory: Path) -> str:
    """Return the id of a run, given by its absolute path, in addresses of the page."""
    return hashlib.sha256(os.fsencode(directory)).hexdigest()[:_ID_LETTERS]
