"""A season's run directory: made at the first start of its server, and opened again at every other."""

from __future__ import annotations

import json
from contextlib import ExitStack
from dataclasses import replace
from datetime import datetime
from pathlib import Path
from typing import Final

from experiment_runner.competition.course import Course, course_of
from experiment_runner.competition.organiser import admissions
from experiment_runner.competition.records import journal
from experiment_runner.competition.records.journal import act
from experiment_runner.competition.records.seal import check_seal, record_acts, seal
from experiment_runner.competition.season.server import attempt_trials
from experiment_runner.competition.season.state import SeasonState
from experiment_runner.competition.settings import Competition, Entrant, changes
from experiment_runner.competition.trials import trials
from experiment_runner.plan.provenance import about, program
from experiment_runner.store.database import holds_run, reported
from experiment_runner.store.layout import ABOUT_FILE, COMPETITION_FILE, JOURNAL_FILE
from experiment_runner.store.store import Store
from glue.errors import ConfigError, ExperimentError

_FOR_ITS_OWNER: Final = 0o700

_FIXED: Final = ("count", "names", "zone")
"""Settings of [season] by which entrants were told that they play."""


def open_season(directory: Path, text: str, competition: Competition, secret: bytes, now: datetime) -> Store:
    """Return the store of a season: a new one, or the one in the directory.

    Settings of `[season]` that have changed since are written to the journal.

    Args:
        directory: contains the run, or will contain it; only its owner may read it.
        text: contents of the competition's file.
        competition: the same, parsed.
        secret: the secret seed.
        now: the time.

    Raises:
        ConfigError: there is no season, an entrant cannot be started, or there is no such environment.
        ExperimentError: the directory holds something else, is in use, or cannot be written to; or something
            was changed that may not be.
    """
    if competition.season is None:
        raise ConfigError("the competition's file has no table [season]: glue-compete run holds it at once")
    trials(replace(competition, tasks=competition.proving), secret)  # a mistake in a task is found at once
    with reported(f"cannot open {directory}"):
        exists = holds_run(directory)
    with ExitStack() as stack:
        if exists:
            store = stack.enter_context(Store.open(directory))
            seal(store)
            check_seal(store)
            _change(store, competition, secret, now)
        else:
            acts = admissions(
                competition, competition.entrants, journal.ENTER, "in the file at the start", now
            )
            with reported(f"cannot write to {directory}"):
                directory.mkdir(mode=_FOR_ITS_OWNER, parents=True, exist_ok=True)
            about_it = json.dumps(about(), indent=2) + "\n"
            files = {COMPETITION_FILE: text, ABOUT_FILE: about_it, JOURNAL_FILE: journal.text_of(acts)}
            store = stack.enter_context(Store.create(directory, [], files))
            seal(store)
        with reported(f"cannot write to {directory}"):
            directory.chmod(_FOR_ITS_OWNER)
        store.record_event("resume" if exists else "start", program())
        stack.pop_all()
    return store


def _change(store: Store, competition: Competition, secret: bytes, now: datetime) -> None:
    """Write to the journal what was changed in the competition's file.

    Raises:
        ExperimentError: it may not be changed.
    """
    course = course_of(store.directory)
    state = SeasonState.of(course)
    if state.closed is not None:
        raise ExperimentError(
            f"the season in {store.directory} was closed at {state.closed}: glue-compete run plays the rest"
        )
    assert competition.season is not None
    found = changes(state.season, competition.season)
    for name in _FIXED:
        if name in found:
            raise ExperimentError(
                f"{name} of [season] was {getattr(state.season, name)!r} when the season began: put that back"
            )
    _check_rules(store, course, competition, secret)
    record_acts(
        store,
        [
            act(journal.CHANGE, name, "in the competition's file", now=now, value=value)
            for name, value in found.items()
        ],
    )


def _check_rules(store: Store, course: Course, competition: Competition, secret: bytes) -> None:
    own = {name for name, one in course.entrants.items() if one.act != journal.ENROL}
    named = {entrant.name for entrant in competition.entrants}
    for name in own ^ named:
        raise ExperimentError(
            f"entrant {name} does not take part yet: glue-compete add lets it"
            if name in named
            else f"entrant {name} takes part: put it back in the competition's file"
        )
    was, back = course.competition, "put that back, or choose another directory"
    for name in ("trials", "limits"):
        if getattr(was, name) != getattr(competition, name):
            raise ExperimentError(f"{name} was {getattr(was, name)} when the season began: {back}")
    if _lengths(was) != _lengths(competition):
        raise ExperimentError(f"the season began with other proving tasks, or other lengths of them: {back}")
    anybody = Entrant("anybody", command=("nothing",))
    planned = {spec.id.parts[1:]: spec for spec in attempt_trials(competition, secret, anybody, 1)}
    for record in store.trials():
        _, task, number = record.spec.id.parts
        spec = planned.get((task, number % competition.trials))
        if spec and (spec.environment, spec.seed) != (record.spec.environment, record.spec.seed):
            raise ExperimentError(
                f"the season began with other options or levels of task {task}, or another secret seed: {back}"
            )


def _lengths(competition: Competition) -> object:
    return [(one.name, one.episodes, one.steps, one.max_steps, one.hidden) for one in competition.proving]
