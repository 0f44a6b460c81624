"""The course of a competition: what its journal has made of its file, and which trials count."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from experiment_runner.competition.records.journal import ADD, ENTER, EXCLUDE, RERUN, Act, act, acts_of
from experiment_runner.competition.records.seal import check_seal, record_acts, seal
from experiment_runner.competition.settings import Competition, load_competition
from experiment_runner.plan.ids import TrialId
from experiment_runner.plan.plan import TrialSpec
from experiment_runner.store.layout import COMPETITION_FILE
from experiment_runner.store.results import Results
from experiment_runner.store.store import Store
from glue.errors import ExperimentError


@dataclass(frozen=True, slots=True)
class Course:
    """A competition with the acts of its organiser.

    Args:
        competition: as it was at the start.
        acts: of its journal; none in a run of version 0.3.
    """

    competition: Competition
    acts: Sequence[Act]

    @property
    def entrants(self) -> Mapping[str, Act]:
        """The entrants by name, with the act that admitted each."""
        entered = {
            one.name: Act("", ENTER, one.name, "", player=one.player) for one in self.competition.entrants
        }
        return entered | {one.subject: one for one in self.acts if one.act in (ENTER, ADD)}

    @property
    def excluded(self) -> Mapping[str, str]:
        """The reason for each exclusion, by the entrant's name."""
        return {one.subject: one.reason for one in self.acts if one.act == EXCLUDE}

    @property
    def reruns(self) -> Mapping[TrialId, TrialId]:
        """The trial that was repeated, by the id of each repetition, oldest first."""
        return {TrialId(one.trial): TrialId(one.subject) for one in self.acts if one.act == RERUN}

    @property
    def counting(self) -> Mapping[TrialId, TrialId]:
        """The trial that counts in place of each trial of the competition: itself, or its last repetition."""
        names = [task.name for task in self.competition.tasks]
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
        named = {one.name for one in competition.entrants}
        for name in named ^ set(entrants):
            raise ExperimentError(
                f"entrant {name} is not in the run yet: glue-compete add can add it"
                if name in named
                else f"entrant {name} takes part in the run: put it back in the competition's file"
            )
        if _rules(self.competition) != _rules(competition):
            raise ExperimentError(
                "the run was begun with other limits, or another number of trials, episodes or steps: put "
                "those of its competition.toml back, or choose another directory"
            )
        known = tuple(replace(one, id=entrants[one.name].id) for one in competition.entrants)
        return replace(competition, entrants=known)

    def planned(self, spec: TrialSpec) -> bool:
        """Return whether a trial was planned from the start, and not by an act since."""
        late = self.entrants[spec.id.parts[0]].act == ADD
        return not late and spec.id not in self.reruns

    def with_reruns(self, specs: Sequence[TrialSpec]) -> list[TrialSpec]:
        """Return the competition's trials and their repetitions, which have the same levels and seeds.

        Raises:
            ExperimentError: the journal repeats a trial that there is not.
        """
        planned = {spec.id: spec for spec in specs}
        for trial in self.reruns.values():
            if trial not in planned:
                raise ExperimentError(f"the journal repeats {trial}, which is no trial of the competition")
        return [*specs, *(replace(planned[trial], id=again) for again, trial in self.reruns.items())]

    def exclusion(self, entrant: str, reason: str) -> Act:
        """Return the act of excluding an entrant.

        Raises:
            ExperimentError: there is no such entrant, or it is excluded.
        """
        if entrant not in self.entrants:
            raise ExperimentError(f"there is no entrant {entrant}; there are {', '.join(self.entrants)}")
        if entrant in self.excluded:
            raise ExperimentError(f"{entrant} is excluded: {self.excluded[entrant]}")
        return act(EXCLUDE, entrant, reason)

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
            made.append(act(RERUN, trial, reason, trial=str(repeated[-1])))
        return made


def _rules(competition: Competition) -> object:
    """Return the rules that are not part of the trials."""
    tasks = [(task.name, task.episodes, task.steps, task.pace) for task in competition.tasks]
    return competition.limits, competition.trials, tasks


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
