"""Hold a competition: let every entrant play every trial of every task, and store what happens.

This process alone writes to the run directory, whose trials are the matches:

    results.sqlite     outcomes and episodes, see `experiment_runner.store`
    competition.toml   the file of the competition, as it was
    records/           what was played, see `experiment_runner.competition.records.record`
    logs/              what each entrant printed

A trial that was interrupted starts over, with a new process and an empty record, as one without a checkpoint
does in an experiment: what an entrant had learned was in its process.
"""

from __future__ import annotations

import json
from collections import Counter, deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Final

from experiment_runner.competition.file import load_competition
from experiment_runner.competition.match import (
    MODULE,
    Forfeited,
    Match,
    Played,
    decode_report,
    encode_match,
    starter_for,
)
from experiment_runner.competition.outside import gate_for
from experiment_runner.competition.records.record import RecordFile, record_path
from experiment_runner.competition.settings import Competition, Gate
from experiment_runner.competition.starting import name_of_run
from experiment_runner.executors.job import Ended, Lost, Recorded
from experiment_runner.executors.local import LocalExecutor
from experiment_runner.plan import TrialSpec
from experiment_runner.provenance import about, program
from experiment_runner.store.database import holds_run, reported
from experiment_runner.store.layout import ABOUT_FILE, COMPETITION_FILE, LOGS
from experiment_runner.store.records import Outcome
from experiment_runner.store.store import Store
from glue.errors import ExperimentError

__all__ = ["competition_of", "hold", "log_path", "matches", "open_competition"]

_WAIT_SECONDS: Final = 0.1
_MAX_LOSSES: Final = 3
"""How often the process of a match may be killed until its trial is given up."""

_FOR_ITS_OWNER: Final = 0o700

Say = Callable[[str], None]


def log_path(directory: Path, trial_id: str) -> Path:
    """Return where the log of a trial's entrant is."""
    return directory / LOGS / f"{trial_id}.log"


def open_competition(
    directory: Path, text: str, competition: Competition, specs: Sequence[TrialSpec]
) -> Store:
    """Return the store of a competition: a new one, or the one in the directory if it is the same.

    Args:
        directory: contains the run, or will contain it; nobody else may read it, for the levels are there.
        text: of the competition's file.
        competition: what that says.
        specs: all trials.

    Raises:
        ExperimentError: the directory holds something else, is in use, or cannot be written to.
    """
    with reported(f"cannot open {directory}"):
        exists = holds_run(directory)
        directory.mkdir(mode=_FOR_ITS_OWNER, parents=True, exist_ok=True)
    if not exists:
        files = {COMPETITION_FILE: text, ABOUT_FILE: json.dumps(about(), indent=2) + "\n"}
        store = Store.create(directory, specs, files)
    else:
        store = Store.open(directory)
    try:
        with reported(f"cannot write to {directory}"):
            directory.chmod(_FOR_ITS_OWNER)
        recorded = [record.spec for record in store.trials()]
        if recorded != list(specs):
            why = _difference(recorded, specs)
            raise ExperimentError(f"{directory} is the run of another competition: {why}")
        if _rules(competition_of(directory)) != _rules(competition):
            raise ExperimentError(
                f"{directory} was begun with other limits, or another number of episodes or steps: put those "
                "of its competition.toml back, or choose another directory with --out"
            )
        store.record_event("resume" if exists else "start", program())
    except BaseException:
        store.close()
        raise
    return store


def competition_of(directory: Path) -> Competition:
    """Return the competition of a run.

    Raises:
        ExperimentError: the directory holds no competition.
    """
    path = directory / COMPETITION_FILE
    if not path.is_file():
        raise ExperimentError(f"{directory} holds no competition: glue-compete run FILE --out DIR makes one")
    return load_competition(path)


def matches(
    competition: Competition, specs: Iterable[TrialSpec], directory: Path, gate: Gate | None = None
) -> list[Match]:
    """Return what the workers do for these trials."""
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
    """Let every entrant play what it has not played yet; return how many trials have failed.

    A trial fails if the environment or this machine does, which is not its entrant's fault; it is played
    again when the competition goes on.

    Args:
        store: of the run.
        competition: what is played.
        workers: how many trials are played at once.
        say: shows a line.
        gate: where entrants from elsewhere connect; None if there are none.

    Raises:
        ConfigError: an entrant cannot be started.
        StorageError: the run cannot be written to.
        KeyboardInterrupt: on Ctrl-C or SIGTERM.
    """
    over = store.outcomes()
    left = [record.spec for record in store.trials() if record.spec.id not in over]
    waiting = matches(competition, left, store.directory, gate)
    if waiting:
        _check_entrants(waiting)
        with LocalExecutor(workers, MODULE, encode_match, decode_report) as executor:
            _Organiser(store, executor, len(over), say).play(waiting)
    return sum(record.failure is not None for record in store.trials())


def _check_entrants(waiting: Iterable[Match]) -> None:
    for match in {match.entrant.name: match for match in waiting}.values():
        starter = starter_for(match.entrant)
        starter.check(match.entrant)
        if match.entrant.key is not None:
            gate_for(match.entrant, match.gate)
        starter.sweep(match.run)


class _Organiser:
    def __init__(self, store: Store, executor: LocalExecutor, over: int, say: Say) -> None:
        self._store = store
        self._executor = executor
        self._over = over
        self._total = len(store.trials())
        self._say = say
        self._running: dict[str, Match] = {}
        self._records: dict[str, RecordFile] = {}
        self._forfeits: dict[str, str] = {}
        self._losses: Counter[str] = Counter()

    def play(self, matches: Iterable[Match]) -> None:
        waiting = deque(matches)
        try:
            while waiting or self._running:
                while len(self._running) < self._executor.size and (match := self._next(waiting)) is not None:
                    self._begin(match)
                for trial_id, report in self._executor.receive(_WAIT_SECONDS):
                    again = self._take(self._running[trial_id], report)
                    if again is not None:
                        waiting.append(again)
        finally:
            for record in self._records.values():
                record.close()

    def _next(self, waiting: deque[Match]) -> Match | None:
        """Return what to begin next; those who connect from elsewhere, to one address, play one at a time."""
        taken = any(match.entrant.key is not None for match in self._running.values())
        for match in waiting:
            if match.entrant.key is None or not taken:
                waiting.remove(match)
                return match
        return None

    def _begin(self, match: Match) -> None:
        trial_id = match.spec.id
        self._store.rewind(trial_id, 0)
        self._records[trial_id] = RecordFile(record_path(self._store.directory, trial_id), trial_id)
        self._forfeits.pop(trial_id, None)
        self._executor.start(match)
        self._running[trial_id] = match

    def _take(self, match: Match, report: object) -> Match | None:
        """Store a report; return a match that has to be played again."""
        trial_id = match.spec.id
        match report:
            case Recorded(result):
                self._store.record(trial_id, result)
            case Played(frame):
                self._records[trial_id].append(frame)
            case Forfeited(reason):
                self._forfeits[trial_id] = reason
            case Ended(None):
                self._end(match)
            case Ended(str(failure)):
                self._fail(match, failure)
            case Lost(why):
                return self._lose(match, why)
        return None

    def _end(self, match: Match) -> None:
        trial_id = match.spec.id
        reason = self._forfeits.get(trial_id)
        del self._running[trial_id]
        self._store.record_outcome(trial_id, Outcome(reason, self._records.pop(trial_id).finish()))
        self._over += 1
        if reason is None:
            totals = self._store.totals(trial_id)
            how = f"{totals.sum_of_returns:.10g} in {totals.episodes} episodes"
        else:
            how = f"forfeited: {reason}"
        self._say(f"[{self._over}/{self._total}] {trial_id}: {how}")

    def _fail(self, match: Match, failure: str) -> None:
        trial_id = match.spec.id
        del self._running[trial_id]
        self._records.pop(trial_id).close()
        self._store.record_failure(trial_id, failure)
        self._say(f"{trial_id} has failed, and is played again when the competition goes on: {failure}")

    def _lose(self, match: Match, why: str) -> Match | None:
        trial_id = match.spec.id
        self._losses[trial_id] += 1
        if self._losses[trial_id] == _MAX_LOSSES:
            self._fail(match, f"{why}, {_MAX_LOSSES} times")
            return None
        del self._running[trial_id]
        self._records.pop(trial_id).close()
        self._store.record_event("lost", why, trial_id)
        self._say(f"{trial_id}: {why}; it starts over")
        return match


def _rules(competition: Competition) -> object:
    """Return what the trials themselves do not say of how they are played."""
    return competition.limits, [(task.name, task.episodes, task.steps) for task in competition.tasks]


def _difference(recorded: Sequence[TrialSpec], specs: Sequence[TrialSpec]) -> str:
    ours, theirs = ({spec.id: spec for spec in some} for some in (recorded, specs))
    hint = "choose another directory with --out"
    for trial_id in [*theirs, *ours]:
        if trial_id not in ours or trial_id not in theirs:
            return (
                f"{'only this one' if trial_id in theirs else 'only that one'} has trial {trial_id}: {hint}"
            )
    changed = next(trial_id for trial_id in ours if ours[trial_id] != theirs[trial_id])
    if _without_secret(ours[changed]) == _without_secret(theirs[changed]):
        return f"its levels were drawn from another secret seed: put that back, or {hint}"
    return f"trial {changed} is another one: {hint}"


def _without_secret(spec: TrialSpec) -> tuple[object, ...]:
    assert spec.environment is not None
    options: Mapping[str, object] = spec.environment.options
    return (spec.agent, spec.environment.name, options.keys(), spec.episodes)
