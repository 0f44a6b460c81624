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
import time
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

from experiment_runner.competition.course import Course, course_of
from experiment_runner.competition.launching import gate_for, launcher_for, name_of_run
from experiment_runner.competition.match import NOT_CONNECTED, Forfeited, Match, Piece
from experiment_runner.competition.records.copies import copies
from experiment_runner.competition.records.journal import ENTER, EVERYBODY, Act, act, text_of
from experiment_runner.competition.records.record import RecordFile, record_path
from experiment_runner.competition.records.seal import (
    add_trials,
    check_seal,
    record_acts,
    record_outcome,
    seal,
)
from experiment_runner.competition.settings import Competition, Entrant, Gate, Limits
from experiment_runner.competition.trials import levels, pseudonym
from experiment_runner.competition.worker import executor
from experiment_runner.executors.dispatcher import Dispatcher
from experiment_runner.executors.interrupts import Interrupts
from experiment_runner.executors.job import Recorded
from experiment_runner.plan.limits import TrialId
from experiment_runner.plan.plan import TrialSpec
from experiment_runner.plan.provenance import about, program
from experiment_runner.store.database import holds_run, reported
from experiment_runner.store.layout import ABOUT_FILE, COMPETITION_FILE, JOURNAL_FILE, LOGS
from experiment_runner.store.records import TrialEnd
from experiment_runner.store.store import Store
from glue.closing import Closing
from glue.errors import ConfigError, ExperimentError
from glue.hub.io.listener import reserve

_FOR_ITS_OWNER: Final = 0o700
_IDLE_SECONDS: Final = 0.5

Say = Callable[[str], None]


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
        # A mistake in a task is found before an engine is asked for anything.
        read = copies([level.environment for level in levels(competition, secret)], directory)
        acts = admissions(competition, competition.entrants, ENTER, "in the file at the start", secret)
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
            store = stack.enter_context(Store.create(directory, specs, {**files, **read}))
        with reported(f"cannot write to {directory}"):
            directory.chmod(_FOR_ITS_OWNER)
        seal(store)
        check_seal(store)
        if new := _missing(store, course, specs):
            add_trials(store, new)
        if changes := course.changes(competition):
            record_acts(store, changes)
        store.record_event("resume" if exists else "start", program())
        stack.pop_all()
    return store


def _missing(store: Store, course: Course, specs: Sequence[TrialSpec]) -> list[TrialSpec]:
    """Return those of the trials that a run does not have yet, as an act of its organiser calls for them.

    Raises:
        ExperimentError: the run is of another competition.
    """
    recorded = [record.spec for record in store.trials()]
    known = {spec.id: spec for spec in recorded}
    new = [spec for spec in specs if spec.id not in known]
    if {spec.id: spec for spec in specs if spec.id in known} != known or any(map(course.planned, new)):
        why = _difference(recorded, specs)
        raise ExperimentError(f"{store.directory} is the run of another competition: {why}")
    return new


def admissions(
    competition: Competition,
    entrants: Iterable[Entrant],
    kind: str,
    reason: str,
    secret: bytes,
    taken: Iterable[str] = (),
) -> list[Act]:
    """Return the acts of admitting entrants, once each can be started.

    Args:
        competition: has the limits; in a season they get pseudonyms.
        entrants: that are admitted.
        kind, reason: of the acts.
        secret: determines their pseudonyms.
        taken: pseudonyms of others.

    Raises:
        ConfigError: one cannot be started; the message names it.
    """
    acts, aliases = [], {*taken}
    for one in entrants:
        alias = "" if competition.season is None else pseudonym(one.name, secret, aliases)
        aliases.add(alias)
        identity = check(one, competition.limits)
        acts.append(act(kind, one.name, reason, player=one.player, id=identity, alias=alias))
    return acts


def check(entrant: Entrant, limits: Limits) -> str:
    """Check that an entrant can be started; return its `Entrant.id`.

    Raises:
        ConfigError: it cannot; the message names it.
    """
    try:
        return launcher_for(entrant).check(entrant, limits)
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
        entrant, task, _ = spec.id.parts
        log = directory / LOGS / f"{spec.id}.log"
        made.append(Match(spec, entrants[entrant], competition.limits, steps[task], log, run, gate))
    return made


def hold(
    store: Store,
    competition: Competition,
    secret: bytes,
    workers: int,
    say: Say,
    gate: Gate | None = None,
    visit: Callable[[Held, float], None] = lambda held, seconds: time.sleep(seconds),
) -> int:
    """Play every trial that is not over; return the number of trials that have failed.

    A trial fails if the environment or this machine does, which is not its entrant's fault; it is played
    again when the competition is continued.

    Args:
        store: of the run.
        competition: the competition.
        secret: the secret seed.
        workers: number of trials played at once.
        say: shows a line.
        gate: where entrants from elsewhere connect; None if there are none.
        visit: called again and again meanwhile; may wait for the seconds that it is given, and record acts.

    Raises:
        ConfigError: an entrant cannot be started.
        StorageError: the run cannot be written to.
        KeyboardInterrupt: on Ctrl-C or SIGTERM.
    """
    with ExitStack() as stack:
        held = stack.enter_context(Held(store, competition, secret, say, gate))
        interrupts = stack.enter_context(Interrupts())
        dispatcher = Dispatcher(executor(workers, competition.tasks), held, interrupts)
        held.begin(dispatcher)
        if gate is not None and held.matches:
            stack.enter_context(reserve(gate.bind))
        dispatcher.run((), lambda: visit(held, 0 if dispatcher.running else _IDLE_SECONDS))
    wanted = set(held.course.trials)
    return sum(record.failure is not None for record in store.trials() if record.spec.id in wanted)


class Matches(Closing):
    """Makes the jobs of matches and stores their reports; see `experiment_runner.executors.dispatcher`.

    Args:
        store: of the run.
        say: shows a line.

    Attributes:
        matches: by the ids of their trials.
        dispatcher: of the jobs, once they may begin.
    """

    def __init__(self, store: Store, say: Say) -> None:
        self.matches: dict[str, Match] = {}
        self._store = store
        self._say = say
        self._records: dict[str, RecordFile] = {}
        self._forfeits: dict[str, str] = {}

    def begin(self, dispatcher: Dispatcher) -> None:
        """Take the dispatcher of the jobs."""
        self.dispatcher: Dispatcher = dispatcher

    def forget(self, trial_id: str) -> None:
        """End a match at once, and forget it."""
        self.dispatcher.cancel(trial_id)
        self.matches.pop(trial_id, None)
        self._forfeits.pop(trial_id, None)
        if trial_id in self._records:
            self._records.pop(trial_id).close()

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


class Held(Matches):
    """The matches of a competition that is held at once, in which its organiser may act meanwhile.

    Args:
        store, competition, secret, say, gate: as of `hold`.

    Attributes:
        course: of the competition, so far.
        over: ids of the trials that are over, of those that are to be played.
    """

    def __init__(
        self, store: Store, competition: Competition, secret: bytes, say: Say, gate: Gate | None
    ) -> None:
        super().__init__(store, say)
        self.course: Course = course_of(store.directory)
        self._competition = competition
        self._secret = secret
        self._gate = gate
        self._paused: Mapping[str, str] = {}
        self._absent: set[str] = set()  # entrants that did not connect the last time
        self.over: set[TrialId] = set()
        if self.course.in_season:
            raise ExperimentError(
                f"the season is not over: glue-compete serve continues it, and glue-compete close "
                f"{store.directory} ends it"
            )

    def begin(self, dispatcher: Dispatcher) -> None:
        """Let everything wait that is not over, once its entrants can be started."""
        super().begin(dispatcher)
        self._plan()
        for match in {match.entrant.name: match for match in self.matches.values()}.values():
            check(match.entrant, match.limits)
            if match.entrant.key is not None:
                gate_for(match.entrant, match.gate)
            launcher_for(match.entrant).sweep(match.run)
        for who, why in self._paused.items():
            self._say(f"{who} is paused: {why}; glue-compete resume {self._store.directory} ends that")

    def record(self, acts: Sequence[Act], added: Iterable[Entrant] = ()) -> None:
        """Write acts to the journal, and carry them out.

        Args:
            acts: of the organiser.
            added: the entrants that they add.

        Raises:
            ExperimentError: its levels were changed, or the run cannot be written to.
        """
        course = Course(self.course.competition, [*self.course.acts, *acts])
        competition = replace(self._competition, entrants=(*self._competition.entrants, *added))
        new = _missing(self._store, course, course.specs(course.admitted(competition), self._secret))
        record_acts(self._store, acts)
        if new:
            add_trials(self._store, new)
        self.course, self._competition = course, competition
        for one in acts:
            self._say(one.line)
        self._plan()

    def _plan(self) -> None:
        """Let everything wait that is to be played, and end what no longer is."""
        wanted = set(self.course.trials)
        self.over = wanted & self._store.outcomes().keys()
        self._paused = self.course.paused
        for trial_id in self.matches.keys() - wanted:
            self.forget(trial_id)
        left = wanted - self.over - self.matches.keys()
        specs = [record.spec for record in self._store.trials() if record.spec.id in left]
        competition = self.course.admitted(self._competition)
        for match in matches(competition, specs, self._store.directory, self._gate):
            self.matches[match.spec.id] = match
            self.dispatcher.add(match.spec.id)

    def may_start(self, trial_id: str, running: Collection[str]) -> bool:
        """Return whether a match may start: entrants that join at the same address play one at a time."""
        if not self._paused.keys().isdisjoint((EVERYBODY, TrialId(trial_id).parts[0])):
            return False
        keyed, *others = (self.matches[one].entrant.key is not None for one in (trial_id, *running))
        return not (keyed and any(others))

    def end(self, trial_id: str, failure: str | None) -> None:
        """Store the outcome of a match, or its failure, and show it."""
        reason = self._forfeits.get(trial_id)
        super().end(trial_id, failure)
        if failure is not None:
            self._say(f"{trial_id} has failed, and is played again when the run is continued: {failure}")
            return
        self.over.add(TrialId(trial_id))
        self._await(self.matches[trial_id].entrant, reason or "")
        if reason is None:
            totals = self._store.totals(trial_id)
            how = f"{totals.sum_of_returns:.10g} in {totals.episodes} episodes"
        else:
            how = f"forfeited: {reason}"
        self._say(f"[{len(self.over)}/{len(self.course.trials)}] {trial_id}: {how}")

    def _await(self, entrant: Entrant, reason: str) -> None:
        """Let an entrant with a key that did not connect play last, and wait for it once more: meanwhile no
        other that has a key can play.
        """
        if entrant.key is None or not reason.startswith(NOT_CONNECTED):
            self._absent.discard(entrant.name)
            return
        left = {one for one, match in self.matches.items() if match.entrant.name == entrant.name}
        if entrant.name in self._absent:
            self.matches.update({one: replace(self.matches[one], absent=reason) for one in left})
        self._absent.add(entrant.name)
        self.dispatcher.postpone(left)


def _difference(recorded: Sequence[TrialSpec], specs: Sequence[TrialSpec]) -> str:
    ours, theirs = ({spec.id: spec for spec in some} for some in (recorded, specs))
    hint = "choose another directory"
    if only := [one for one in (*theirs, *ours) if one not in ours or one not in theirs]:
        return f"{'only this one' if only[0] in theirs else 'only that one'} has trial {only[0]}: {hint}"
    changed = next(trial_id for trial_id in ours if ours[trial_id] != theirs[trial_id])
    was, now = ours[changed], theirs[changed]
    if was.environment and now.environment and was.seed == now.seed:
        options, others = was.environment.options, now.environment.options
        for name, value in options.items():
            if name in others and others[name] != value:
                return f"{name} of {changed} was {value}, not {others[name]}: put that back, or {hint}"
    if _without_secret(was) == _without_secret(now):
        return f"its levels were drawn from another secret seed: put that back, or {hint}"
    return f"trial {changed} is another one: {hint}"


def _without_secret(spec: TrialSpec) -> tuple[object, ...]:
    assert spec.environment is not None
    options: Mapping[str, object] = spec.environment.options
    return (spec.agent, spec.environment.name, options.keys(), spec.episodes)
