"""Hold a competition: let every entrant play every trial of every task, and store the results.

Only this process writes to the run directory, whose trials are the matches:

    results.sqlite     outcomes and episodes, see `experiment_runner.store`
    competition.toml   the competition's file, as it was at the start
    journal.jsonl      what its organiser has done since, see `records.journal`
    records/           actions and rewards, recordings without observations
    logs/              output of each entrant

An interrupted trial starts over, with a new process and an empty record, like an experiment's trial without a
checkpoint: the entrant's learning was lost with its process.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from contextlib import ExitStack
from datetime import datetime
from pathlib import Path
from typing import Any, Final

from experiment_runner.competition.course import Course, course_of
from experiment_runner.competition.match import MODULE, REPORTS, Forfeited, Match, Piece
from experiment_runner.competition.records.journal import ENTER, Act, act, text_of
from experiment_runner.competition.records.record import RecordFile, record_path
from experiment_runner.competition.records.seal import (
    add_trials,
    check_seal,
    record_acts,
    record_outcome,
    seal,
)
from experiment_runner.competition.settings import Competition, Entrant, Gate, Limits
from experiment_runner.competition.starters import gate_for, name_of_run, starter_for
from experiment_runner.competition.trials import levels
from experiment_runner.executors.dispatcher import Dispatcher
from experiment_runner.executors.interrupts import Interrupts
from experiment_runner.executors.job import Recorded
from experiment_runner.executors.workers import LocalExecutor
from experiment_runner.plan.plan import TrialSpec
from experiment_runner.plan.provenance import about, program
from experiment_runner.store.database import holds_run, reported
from experiment_runner.store.layout import ABOUT_FILE, COMPETITION_FILE, JOURNAL_FILE, LOGS
from experiment_runner.store.records import TrialEnd
from experiment_runner.store.store import Store
from glue.closing import Closing
from glue.errors import ConfigError, ExperimentError

_FOR_ITS_OWNER: Final = 0o700

Say = Callable[[str], None]


def log_path(directory: Path, trial_id: str) -> Path:
    """Return the path of the log of a trial's entrant."""
    return directory / LOGS / f"{trial_id}.log"


def open_competition(directory: Path, text: str, competition: Competition, secret: bytes) -> Store:
    """Return the store of a competition: a new one, or the one in the directory if it is the same. There, a
    season gets the rules that its file has now.

    Args:
        directory: contains the run, or will contain it; only its owner may read it, as it has secret levels.
        text: contents of the competition's file.
        competition: the same, parsed.
        secret: the secret seed.

    Raises:
        ConfigError: an entrant cannot be started, or there is no such environment or option.
        ExperimentError: the directory holds something else, is in use, or cannot be written to.
    """
    with reported(f"cannot open {directory}"):
        exists = holds_run(directory)
    if exists:
        course = course_of(directory)
    else:
        levels(competition, secret)  # a mistake in a task is found before an engine is asked for anything
        acts = admissions(competition, competition.entrants, ENTER, "in the file at the start")
        course = Course(competition, acts)
    specs = course.specs(course.admitted(competition), secret)
    with reported(f"cannot write to {directory}"):
        directory.mkdir(mode=_FOR_ITS_OWNER, parents=True, exist_ok=True)
    with ExitStack() as stack:
        if exists:
            store = stack.enter_context(Store.open(directory))
        else:
            about_it = json.dumps(about(), indent=2) + "\n"
            files = {COMPETITION_FILE: text, ABOUT_FILE: about_it, JOURNAL_FILE: text_of(course.acts)}
            store = stack.enter_context(Store.create(directory, specs, files))
        with reported(f"cannot write to {directory}"):
            directory.chmod(_FOR_ITS_OWNER)
        seal(store)
        check_seal(store)
        recorded = [record.spec for record in store.trials()]
        known = {spec.id: spec for spec in recorded}
        new = [spec for spec in specs if spec.id not in known]
        if {spec.id: spec for spec in specs if spec.id in known} != known or any(map(course.planned, new)):
            why = _difference(recorded, specs)
            raise ExperimentError(f"{directory} is the run of another competition: {why}")
        if new:
            add_trials(store, new)
        if changes := course.changes(competition):
            record_acts(store, changes)
        store.record_event("resume" if exists else "start", program())
        stack.pop_all()
    return store


def admissions(
    competition: Competition, entrants: Iterable[Entrant], kind: str, reason: str, now: datetime | None = None
) -> list[Act]:
    """Return the acts of admitting entrants, once each can be started.

    Raises:
        ConfigError: one cannot; the message names it.
    """
    return [
        act(kind, one.name, reason, now=now, player=one.player, id=check(one, competition.limits))
        for one in entrants
    ]


def check(entrant: Entrant, limits: Limits) -> str:
    """Check that an entrant can be started; return its `Entrant.id`.

    Raises:
        ConfigError: it cannot; the message names it.
    """
    try:
        return starter_for(entrant).check(entrant, limits)
    except ConfigError as error:
        raise ConfigError(f"entrant {entrant.name}: {error}", settings=error.settings) from None


def matches(
    competition: Competition, specs: Iterable[TrialSpec], directory: Path, gate: Gate | None = None
) -> list[Match]:
    """Return the matches of these trials."""
    entrants = {entrant.name: entrant for entrant in competition.entrants}
    steps = {task.name: task.steps for task in competition.tasks}
    run = name_of_run(directory)
    made = []
    for spec in specs:
        assert spec.agent is not None
        assert spec.environment is not None
        entrant = entrants[spec.agent.label]
        log = log_path(directory, spec.id)
        made.append(Match(spec, entrant, competition.limits, steps[spec.environment.label], log, run, gate))
    return made


def hold(store: Store, competition: Competition, workers: int, say: Say, gate: Gate | None = None) -> int:
    """Play every trial that is not over; return the number of trials that have failed.

    A trial fails if the environment or this machine does, which is not its entrant's fault; it is played
    again when the competition is continued.

    Args:
        store: of the run.
        competition: the competition.
        workers: number of trials played at once.
        say: shows a line.
        gate: where entrants from elsewhere connect; None if there are none.

    Raises:
        ConfigError: an entrant cannot be started.
        StorageError: the run cannot be written to.
        KeyboardInterrupt: on Ctrl-C or SIGTERM.
    """
    course = course_of(store.directory)
    if course.in_season:
        raise ExperimentError(
            f"the season is not over: glue-compete serve goes on with it, and glue-compete close "
            f"{store.directory} ends it"
        )
    competition = course.admitted(competition)
    wanted = set(course.trials)
    over = wanted & store.outcomes().keys()
    left = [record.spec for record in store.trials() if record.spec.id in wanted - over]
    waiting = matches(competition, left, store.directory, gate)
    if waiting:
        for match in {match.entrant.name: match for match in waiting}.values():
            check(match.entrant, match.limits)
            if match.entrant.key is not None:
                gate_for(match.entrant, match.gate)
            starter_for(match.entrant).sweep(match.run)
        executor = LocalExecutor(workers, MODULE, REPORTS, warm=[task.env for task in competition.tasks])
        with _Held(store, waiting, len(over), say) as played, Interrupts() as interrupts:
            Dispatcher(executor, played, interrupts).run(match.spec.id for match in waiting)
    return sum(record.failure is not None for record in store.trials() if record.spec.id in wanted)


class Matches(Closing):
    """Makes the jobs of matches and stores their reports; see `experiment_runner.executors.dispatcher`.

    Args:
        store: of the run.
        say: shows a line.

    Attributes:
        matches: by the ids of their trials.
    """

    def __init__(self, store: Store, say: Say) -> None:
        self.matches: dict[str, Match] = {}
        self._store = store
        self._say = say
        self._records: dict[str, RecordFile] = {}
        self._forfeits: dict[str, str] = {}

    def close(self) -> None:
        """Close the records of matches in progress."""
        for record in self._records.values():
            record.close()

    def may_start(self, trial_id: str, running: Collection[str]) -> bool:
        """Return whether a match may start."""
        return True

    def start(self, trial_id: str) -> Any:
        """Return a match, to be played from its beginning."""
        self._store.rewind(trial_id, 0)
        self._records[trial_id] = RecordFile(record_path(self._store.directory, trial_id))
        self._forfeits.pop(trial_id, None)
        return self.matches[trial_id]

    def take(self, trial_id: str, report: Any) -> None:
        """Store a report."""
        match report:
            case Recorded(result):
                self._store.record(trial_id, result)
            case Piece(data):
                self._records[trial_id].append(data)
            case Forfeited(reason):
                self._forfeits[trial_id] = reason

    def commit(self) -> None:
        """Do nothing: every report is stored at once."""

    def lost(self, trial_id: str, why: str) -> int:
        """Store that the process of a match was lost; return 0, as the match starts over."""
        self._store.record_event("lost", why, trial_id)
        self._say(f"{trial_id}: {why}")
        return 0

    def starts_again(self, trial_id: str) -> bool:
        """Return True: a match that was lost starts over."""
        self._records.pop(trial_id).close()
        self._say(f"{trial_id} starts over")
        return True

    def end(self, trial_id: str, failure: str | None) -> None:
        """Store the outcome of a match, or its failure."""
        if failure is None:
            self._finish(trial_id)
        else:
            self._records.pop(trial_id).close()
            self._store.record_failure(trial_id, failure)

    def _finish(self, trial_id: str) -> TrialEnd:
        """Store how a match ended, and return it."""
        outcome = TrialEnd(self._forfeits.pop(trial_id, None), self._records.pop(trial_id).finish())
        record_outcome(self._store, trial_id, outcome)
        return outcome


class _Held(Matches):
    """The matches of a competition that is held at once, of which `over` are over."""

    def __init__(self, store: Store, matches: Iterable[Match], over: int, say: Say) -> None:
        super().__init__(store, say)
        self.matches = {match.spec.id: match for match in matches}
        self._over = over
        self._total = over + len(self.matches)

    def may_start(self, trial_id: str, running: Collection[str]) -> bool:
        """Return whether a match may start: entrants that join at the same address play one at a time."""
        joins = self._joins_from_elsewhere
        return not (joins(trial_id) and any(map(joins, running)))

    def _joins_from_elsewhere(self, trial_id: str) -> bool:
        return self.matches[trial_id].entrant.key is not None

    def end(self, trial_id: str, failure: str | None) -> None:
        """Store the outcome of a match, or its failure, and show it."""
        reason = self._forfeits.get(trial_id)
        super().end(trial_id, failure)
        if failure is not None:
            self._say(f"{trial_id} has failed, and is played again when the run is continued: {failure}")
            return
        self._over += 1
        if reason is None:
            totals = self._store.totals(trial_id)
            how = f"{totals.sum_of_returns:.10g} in {totals.episodes} episodes"
        else:
            how = f"forfeited: {reason}"
        self._say(f"[{self._over}/{self._total}] {trial_id}: {how}")


def _difference(recorded: Sequence[TrialSpec], specs: Sequence[TrialSpec]) -> str:
    ours, theirs = ({spec.id: spec for spec in some} for some in (recorded, specs))
    hint = "choose another directory"
    for trial_id in [*theirs, *ours]:
        if trial_id not in ours or trial_id not in theirs:
            return (
                f"{'only this one' if trial_id in theirs else 'only that one'} has trial {trial_id}: {hint}"
            )
    changed = next(trial_id for trial_id in ours if ours[trial_id] != theirs[trial_id])
    was, now = ours[changed], theirs[changed]
    if was.environment and now.environment and was.seed == now.seed:
        options, others = was.environment.options, now.environment.options
        for name in options.keys() & others.keys():
            if options[name] != others[name]:
                return (
                    f"{name} of {changed} was {options[name]}, not {others[name]}: put that back, or {hint}"
                )
    if _without_secret(was) == _without_secret(now):
        return f"its levels were drawn from another secret seed: put that back, or {hint}"
    return f"trial {changed} is another one: {hint}"


def _without_secret(spec: TrialSpec) -> tuple[object, ...]:
    assert spec.environment is not None
    options: Mapping[str, object] = spec.environment.options
    return (spec.agent, spec.environment.name, options.keys(), spec.episodes)
