"""The course of a competition: what its journal has made of its file, and which trials count."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

from experiment_runner.competition.records import journal
from experiment_runner.competition.records.copies import without_place
from experiment_runner.competition.records.journal import EVERYBODY, Act, act, acts_of
from experiment_runner.competition.settings import Competition, Entrant, changes, load_competition
from experiment_runner.competition.state import IMAGE_ID, Enrolled, State
from experiment_runner.competition.trials import Level, attempt_trials, levels, trials
from experiment_runner.plan.limits import TrialId
from experiment_runner.plan.plan import TrialSpec
from experiment_runner.store.layout import COMPETITION_FILE
from glue.errors import ExperimentError


@dataclass(frozen=True)
class Course:
    """A competition with the acts of its organiser.

    Args:
        competition: as it was at the start.
        acts: of its journal; none in a run of before there were journals.
    """

    competition: Competition
    acts: list[Act]

    @cached_property
    def state(self) -> State:
        """The state after all acts.

        Raises:
            ExperimentError: an act cannot have been.
        """
        # Runs of before there were journals have no acts that admit the entrants of the file.
        acts = [Act("", journal.ENTER, one.name, "", player=one.player) for one in self.competition.entrants]
        state = State(self.competition.season, {one.subject: Enrolled(one) for one in acts})
        for one in self.acts:
            state.apply(one)
        return state

    @property
    def entrants(self) -> Mapping[str, Act]:
        """The entrants by name, with the act that admitted each, which has its present player and id."""
        return {name: one.present for name, one in self.state.entrants.items()}

    @property
    def in_season(self) -> bool:
        """Whether there is a season that is not closed, so that no testing task is played yet."""
        return self.state.rules is not None and self.state.closed is None

    @property
    def excluded(self) -> Mapping[str, str]:
        """The reason for each exclusion, by the entrant's name."""
        return {name: one.excluded for name, one in self.state.entrants.items() if one.excluded}

    @property
    def paused(self) -> Mapping[str, str]:
        """The reason why nothing is started of an entrant, or of `EVERYBODY`."""
        found = {EVERYBODY: self.state.paused}
        found |= {name: one.paused for name, one in self.state.entrants.items()}
        return {who: why for who, why in found.items() if why}

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
        named = {one.name for one in competition.entrants}
        for name in named ^ {name for name, one in entrants.items() if one.act != journal.ENROL}:
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
        known = {one.name: one for one in competition.entrants}
        found = (entrant_of(one, known.get(name)) for name, one in entrants.items())
        return replace(competition, entrants=tuple(found))

    def check_trials(self, specs: Iterable[TrialSpec]) -> None:
        """Check that the trials of a run, which may come from anyone, are of the tasks of its file.

        The levels and seeds drawn from the secret seed are not known here.

        Raises:
            ExperimentError: one has no task, or another environment or length than its task.
        """
        tasks = {task.name: task for task in self.competition.tasks}
        for spec in specs:
            entrant, name, number = spec.id.parts
            if (task := tasks.get(name)) is None:
                raise ExperimentError(f"{spec.id!s:.80} is of a task that {COMPETITION_FILE} does not have")
            played = spec.environment
            if (
                played is None
                or without_place(played.name) != without_place(task.env)
                or not task.options.items() <= played.options.items()
                or replace(Level(task, number, played, spec.seed).trial(entrant, "", ""), agent=spec.agent)
                != spec
            ):
                raise ExperimentError(
                    f"{spec.id!s:.80} has another environment or length than its task in {COMPETITION_FILE}"
                )

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
                raise ExperimentError(f"the journal repeats {trial}, which is not a trial of the competition")
        again = [replace(planned[trial], id=repetition) for repetition, trial in self.reruns.items()]
        return [*attempts, *planned.values(), *again]

    def changes(self, competition: Competition) -> list[Act]:
        """Return the acts of giving the season the rules that its file has now."""
        was, now = self.state.rules, competition.season
        if was is None or now is None or not self.in_season:
            return []
        return [
            act(journal.CHANGE, name, "in the file", value=value) for name, value in changes(was, now).items()
        ]


def _rules(competition: Competition) -> dict[str, object]:
    """Return the rules that are not part of the trials, by their names.

    A season makes its trials later, so what they are made of is among its rules.
    """
    later = () if competition.season is None else competition.tasks
    return {
        "limits": competition.limits,
        "trials": competition.trials,
        "tasks": {task.name for task in competition.tasks},
        "episodes or steps": [(task.name, task.episodes, task.steps) for task in competition.tasks],
        "rate or late": [(task.name, task.pace) for task in competition.tasks],
        "phases": [(task.name, task.phase, task.hidden) for task in competition.tasks],
        "env": [(task.name, without_place(task.env)) for task in later],
        "options": [(task.name, task.options) for task in later],
        "levels": [(task.name, [path.name for path in task.levels]) for task in later],
        "max_steps": [(task.name, task.max_steps) for task in later],
    }


def entrant_of(playing: Act, named: Entrant | None = None) -> Entrant:
    """Return an entrant as it plays.

    Args:
        playing: has its player and id.
        named: the entrant as the file names it; None if it has enrolled.
    """
    image = IMAGE_ID.fullmatch(playing.id)
    if named is not None and (not image or named.player == playing.player):
        return replace(named, id=playing.id)
    if image:
        return Entrant(playing.subject, image=playing.player, id=playing.id)
    return Entrant(playing.subject, key=Path(playing.player), id=playing.id)


def course_of(directory: Path) -> Course:
    """Return the course of a run.

    Raises:
        ExperimentError: the directory holds no competition, or its journal cannot be read.
    """
    path = directory / COMPETITION_FILE
    if not path.is_file():
        raise ExperimentError(f"{directory} holds no competition: glue-compete run makes one")
    return Course(load_competition(path, follow=False), acts_of(directory))
