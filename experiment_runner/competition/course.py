"""The course of a competition: what its journal has made of its file, and which trials count."""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

from experiment_runner.competition.records import journal
from experiment_runner.competition.records.journal import Act, act, acts_of
from experiment_runner.competition.records.seal import check_seal, record_acts, seal
from experiment_runner.competition.settings import (
    Competition,
    Entrant,
    Season,
    changed,
    changes,
    load_competition,
)
from experiment_runner.competition.trials import attempt_trials, levels, trials
from experiment_runner.plan.limits import TrialId
from experiment_runner.plan.plan import TrialSpec
from experiment_runner.store.layout import COMPETITION_FILE
from experiment_runner.store.results import Results
from experiment_runner.store.store import Store
from glue.errors import ExperimentError

IMAGE_ID: Final = re.compile(r"sha256:[0-9a-f]{64}")
"""The ids of images."""


@dataclass(frozen=True, slots=True)
class Course:
    """A competition with the acts of its organiser.

    Args:
        competition: as it was at the start.
        acts: of its journal.
    """

    competition: Competition
    acts: Sequence[Act]

    @property
    def entrants(self) -> Mapping[str, Act]:
        """The entrants by name, with the act that admitted each, which has its present player and id."""
        found: dict[str, Act] = {}
        for one in self.acts:
            if one.act in (journal.ENTER, journal.ADD, journal.ENROL):
                found[one.subject] = one
            elif one.act == journal.IMAGE and one.subject in found:
                found[one.subject] = replace(found[one.subject], player=one.player, id=one.id)
        return found

    @property
    def season(self) -> Season | None:
        """The rules of the season, with the changes that were made to them; None if there is none.

        Raises:
            ExperimentError: a change is not allowed.
        """
        found = self.competition.season
        for one in self.acts:
            if found is not None and one.act == journal.CHANGE:
                found = changed(found, one.subject, one.value)
        return found

    @property
    def in_season(self) -> bool:
        """Whether there is a season that is not closed, so that no testing task is played yet."""
        return self.competition.season is not None and all(one.act != journal.CLOSE for one in self.acts)

    @property
    def excluded(self) -> Mapping[str, str]:
        """The reason for each exclusion, by the entrant's name."""
        return self._in_force(journal.EXCLUDE, journal.READMIT)

    @property
    def paused(self) -> Mapping[str, str]:
        """The reason why no trial of an entrant, or of `EVERYBODY`, is started, outside of a season."""
        return self._in_force(journal.PAUSE, journal.RESUME, journal.CLOSE)

    def _in_force(self, begins: str, ends: str, ends_all: str | None = None) -> Mapping[str, str]:
        """Return the reason of each act of the kind `begins` that none since has ended, by its subject."""
        found: dict[str, str] = {}
        for one in self.acts:
            if one.act == begins:
                found[one.subject] = one.reason
            elif one.act == ends:
                found.pop(one.subject, None)
            elif one.act == ends_all:
                found.clear()
        return found

    @property
    def images(self) -> set[str]:
        """The ids with which somebody may still play: those of the entrants and, while the season is not
        closed, all that have played, as any attempt can be run again.
        """
        played = [one for one in self.acts if one.act == journal.START] if self.in_season else []
        return {one.id for one in (*self.entrants.values(), *played)}

    @property
    def reruns(self) -> Mapping[TrialId, TrialId]:
        """The trial that was repeated, by the id of each repetition, oldest first."""
        return {
            TrialId(one.trial): TrialId(one.subject)
            for one in self.acts
            if one.act == journal.RERUN and one.trial
        }

    @property
    def counting(self) -> Mapping[TrialId, TrialId]:
        """The trial that counts in place of each trial of a testing task: itself, or its last repetition.

        There is none while the season is not closed.
        """
        names = [] if self.in_season else [task.name for task in self.competition.testing]
        planned = [
            TrialId.of(entrant, task, number)
            for task in names
            for number in range(self.competition.trials)
            for entrant in self.entrants
        ]
        last = {repeated: repetition for repetition, repeated in self.reruns.items()}
        return {trial: last.get(trial, trial) for trial in planned}

    @property
    def trials(self) -> list[TrialId]:
        """The trials that are to be played: those that count, of entrants who are not excluded."""
        excluded = self.excluded
        return [trial for trial in self.counting.values() if trial.parts[0] not in excluded]

    def admitted(self, competition: Competition) -> Competition:
        """Return the competition with what the names of its entrants stood for when they were admitted.

        Raises:
            ExperimentError: it has other entrants, or other rules than at the start.
        """
        entrants = self.entrants
        enrolled = {one.subject for one in self.acts if one.act == journal.ENROL}
        named = {one.name for one in competition.entrants}
        for name in named ^ (set(entrants) - enrolled):
            raise ExperimentError(
                f"entrant {name} is not in the run yet: glue-compete add can add it"
                if name in named
                else f"entrant {name} takes part in the run: put it back in the competition's file"
            )
        was, now = _rules(self.competition), _rules(competition)
        for what in was:
            if was[what] != now[what]:
                raise ExperimentError(
                    f"the run was begun with other {what}: put back what its competition.toml has, or choose "
                    "another directory"
                )
        submitted = {one.subject for one in self.acts if one.act == journal.IMAGE}
        known = {one.name: one for one in competition.entrants if one.name not in submitted}
        found = (
            replace(known[name], id=one.id) if name in known else entrant_of(one)
            for name, one in entrants.items()
        )
        return replace(competition, entrants=tuple(found))

    def planned(self, spec: TrialSpec) -> bool:
        """Return whether a trial was planned from the start, and not by an act since."""
        late = self.competition.season is not None or self.entrants[spec.id.parts[0]].act == journal.ADD
        return not late and spec.id not in self.reruns

    def specs(self, competition: Competition, secret: bytes) -> list[TrialSpec]:
        """Return the trials that there are: the attempts of a season and, unless it is not closed, the trials
        of the testing tasks and their repetitions, which have the same levels and seeds.

        Args:
            competition: as it is now, see `admitted`.
            secret: its secret seed.

        Raises:
            ConfigError: there is no such environment, or an option is wrong.
            ExperimentError: the journal repeats a trial that there is not.
        """
        starts = [one for one in self.acts if one.act == journal.START]
        drawn = levels(competition, secret) if starts else []
        attempts = [spec for one in starts for spec in attempt_trials(drawn, competition.trials, one)]
        testing = [] if self.in_season else trials(competition, secret)
        planned = {spec.id: spec for spec in testing}
        for trial in self.reruns.values():
            if trial not in planned:
                raise ExperimentError(f"the journal repeats {trial}, which is no trial of the competition")
        again = [replace(planned[trial], id=repetition) for repetition, trial in self.reruns.items()]
        return [*attempts, *planned.values(), *again]

    def changes(self, competition: Competition) -> list[Act]:
        """Return the acts of giving the season the rules that its file has now."""
        was, now = self.season, competition.season
        if was is None or now is None or not self.in_season:
            return []
        return [
            act(journal.CHANGE, name, "in the file", value=value) for name, value in changes(was, now).items()
        ]

    def exclusion(self, entrant: str, reason: str) -> Act:
        """Return the act of excluding an entrant.

        Raises:
            ExperimentError: there is no such entrant, or it is excluded.
        """
        if entrant not in self.entrants:
            raise ExperimentError(f"there is no entrant {entrant}; there are {', '.join(self.entrants)}")
        if entrant in self.excluded:
            raise ExperimentError(f"{entrant} is excluded: {self.excluded[entrant]}")
        return act(journal.EXCLUDE, entrant, reason)

    def repetitions(self, trials: Iterable[str], over: Collection[str], reason: str) -> list[Act]:
        """Return the acts of playing trials of the competition again.

        Args:
            trials: their ids, as in `alice/easy/0`.
            over: ids of the trials that are over.
            reason: for it.

        Raises:
            ExperimentError: there is no such trial, or it is not over.
        """
        made: list[Act] = []
        counting, repeated = self.counting, list(self.reruns)
        for trial in dict.fromkeys(trials):
            found = counting.get(TrialId(trial))
            if found is None:
                raise ExperimentError(
                    f"there is no trial {trial}: give entrant, task and number, as in {next(iter(counting))}"
                )
            if found not in over:
                raise ExperimentError(f"{trial} is not over: glue-compete run plays it anyway")
            entrant, task, _ = found.parts
            number = self.competition.trials + sum(one.parts[:2] == (entrant, task) for one in repeated)
            repeated.append(TrialId.of(entrant, task, number))
            made.append(act(journal.RERUN, trial, reason, trial=str(repeated[-1])))
        return made


def _rules(competition: Competition) -> dict[str, object]:
    """Return the rules that are not part of the trials, by their names."""
    return {
        "limits": competition.limits,
        "trials": competition.trials,
        "tasks": {task.name for task in competition.tasks},
        "episodes or steps": [(task.name, task.episodes, task.steps) for task in competition.tasks],
        "rate or late": [(task.name, task.pace) for task in competition.tasks],
        "phases": [(task.name, task.phase, task.hidden) for task in competition.tasks],
    }


def entrant_of(admitted: Act) -> Entrant:
    """Return an entrant that enrolled or submitted an image, from the act that admitted it."""
    if IMAGE_ID.fullmatch(admitted.id):
        return Entrant(admitted.subject, image=admitted.player, id=admitted.id)
    return Entrant(admitted.subject, key=Path(admitted.player), id=admitted.id)


def course_of(directory: Path) -> Course:
    """Return the course of a run.

    Raises:
        ExperimentError: the directory holds no competition, or its journal cannot be read.
    """
    path = directory / COMPETITION_FILE
    if not path.is_file():
        raise ExperimentError(f"{directory} holds no competition: glue-compete run makes one")
    return Course(load_competition(path, follow=False), acts_of(directory))


def act_on(directory: Path, make: Callable[[Course, Results], list[Act]]) -> list[Act]:
    """Append acts to the journal of a run, renew its seal, and return them.

    Args:
        directory: of the run.
        make: returns the acts for what the run is now.

    Raises:
        ExperimentError: the directory holds no competition, is in use, was changed since it was sealed or
            cannot be written to; or `make` raises it.
    """
    with Store.open(directory) as store:
        seal(store)
        check_seal(store)
        made = make(course_of(directory), store)
        record_acts(store, made)
    return made
