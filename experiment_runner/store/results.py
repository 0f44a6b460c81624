"""Reading a run directory."""

from __future__ import annotations

import json
import math
from collections.abc import Collection, Sequence
from pathlib import Path
from typing import Any, Final, Self

import numpy as np
import numpy.typing as npt

from experiment_runner.plan.ids import TrialId
from experiment_runner.plan.limits import COUNTS
from experiment_runner.plan.plan import RoleSpec, TrialSpec
from experiment_runner.store.database import Database, open_to_read, reported
from experiment_runner.store.readings import Metric, unpacked
from experiment_runner.store.records import (
    MEASURES,
    Answered,
    Checkpoint,
    EpisodeResult,
    OutsidePlayer,
    ReplayVerdict,
    RunEvent,
    Totals,
    TrialEnd,
    TrialRecord,
    Void,
)
from glue.closing import Closing
from glue.errors import ExperimentError

_Types = tuple[type, ...]
_TEXT: Final[_Types] = (str,)
_TEXT_OR_NULL: Final[_Types] = (str, type(None))
_WHOLE: Final[_Types] = (int,)
_NUMBER: Final[_Types] = (int, float)
_NUMBER_OR_NULL: Final[_Types] = (int, float, type(None))
_BYTES: Final[_Types] = (bytes,)
_NULL: Final[_Types] = (type(None),)
_STORED: Final = {  # types of the values of each measure; NULL for NaN, and if recorded without the measure
    name: {float: _NUMBER, str: _TEXT}.get(measure.kind, _WHOLE)
    + (() if "NOT NULL" in measure.sql else _NULL)
    for name, measure in MEASURES.items()
}
_COLUMNS: Final = {name: measure.sql.partition(" ")[0] for name, measure in MEASURES.items()}
_LAST_SECOND: Final = 253_402_300_799  # of the year 9999, the last that a date can have


class Results(Closing):
    """Reads a run directory, also while it is written to. A context manager that closes it.

    A run may come from anyone, so everything read is checked. Every method raises `ExperimentError` when
    the database cannot be read, or contains values that no run has.
    """

    def __init__(self, directory: Path, database: Database) -> None:
        self.directory = directory
        self._database = database

    @classmethod
    def open(cls, directory: Path) -> Self:
        """Return the results in a run directory, for reading.

        Raises:
            ExperimentError: there is no run, or it cannot be read.
        """
        with reported(f"cannot read {directory}"):
            return cls(directory, open_to_read(directory))

    def close(self) -> None:
        """Close the files."""
        self._database.close()

    def trials(self) -> list[TrialRecord]:
        """Return the record of every trial, in the order of the plan."""
        rows = self._query(
            """SELECT id, agent, environment, trials.episodes, max_steps, seed, trials.steps,
                (SELECT count(*) FROM episodes WHERE trial = key), ifnull(voided, 0),
                iif(trials.steps, (SELECT ifnull(sum(steps), 0) FROM episodes WHERE trial = key), 0), failure
                FROM trials LEFT JOIN
                (SELECT trial, count(*) AS voided FROM voids GROUP BY trial) AS v ON v.trial = key
                ORDER BY key"""
        )
        self._check(rows, (_TEXT, _TEXT_OR_NULL, _TEXT_OR_NULL, *[_WHOLE] * 7, _TEXT_OR_NULL))
        return [self._trial(*row) for row in rows]

    def joined_players(self) -> dict[tuple[str, str], str]:
        """Return the name of the last player that joined from outside, by trial and role."""
        return {(player.trial_id, player.role): player.name for player in self.players()}

    def trial_names(self) -> dict[str, str]:
        """Return the name of each trial by its id: the id with the names of players from outside."""
        joined = self.joined_players()
        return {record.spec.id: record.spec.named(joined) for record in self.trials()}

    def episodes(self, trial_id: str) -> list[EpisodeResult]:
        """Return the episodes of a trial so far, in order; a return may be NaN."""
        rows = self._query(
            f"""SELECT episode, {", ".join(_COLUMNS.values())} FROM episodes
                WHERE trial = (SELECT key FROM trials WHERE id = ?) ORDER BY episode""",
            trial_id,
        )
        self._check(rows, (_WHOLE, *_STORED.values()), numbered=True)
        kinds = [measure.kind for measure in MEASURES.values()]
        return [
            EpisodeResult._make(
                (episode, *(math.nan if v is None else k(v) for k, v in zip(kinds, values, strict=True)))
            )
            for episode, *values in rows
        ]

    def returns(self, trial_id: str) -> npt.NDArray[np.float64]:
        """Return the episode returns of a trial so far, shape (episodes,)."""
        return self.measure(trial_id, "return")

    def measure(self, trial_id: str, name: str) -> npt.NDArray[np.float64]:
        """Return one of `MEASURES` for the episodes of a trial so far, shape (episodes,).

        Args:
            trial_id: of the trial.
            name: of a measure that is a number or a bool.
        """
        rows = self._query(
            f"""SELECT episode, {_COLUMNS[name]} FROM episodes
                WHERE trial = (SELECT key FROM trials WHERE id = ?) ORDER BY episode""",
            trial_id,
        )
        self._check(rows, (_WHOLE, _STORED[name]), numbered=True)
        return np.array([value for _, value in rows], np.float64)  # None becomes NaN

    def sums_until(self, trial_id: str, episode: int) -> tuple[int, float]:
        """Return the sums of the steps and of the returns of a trial's episodes up to `episode`, inclusive.

        The returns are added one by one in their order, as in the trial.
        """
        steps, total = self.measure(trial_id, "steps"), 0.0
        for value in self.measure(trial_id, "return")[:episode].tolist():
            total += value
        return int(steps[:episode].sum()), total

    def cut_by_budget(self, trial_id: str) -> bool:
        """Return whether the trial's budget of steps has cut off its last episode."""
        rows = self._query(
            """SELECT trials.steps AND NOT terminal AND trials.steps =
                (SELECT sum(steps) FROM episodes WHERE trial = key) FROM trials JOIN episodes ON trial = key
                WHERE id = ? ORDER BY episode DESC LIMIT 1""",
            trial_id,
        )
        self._check(rows, (_WHOLE,))
        return bool(rows and rows[0][0])

    def totals(self, trial_id: str, last: int | None = None) -> Totals:
        """Return sums over the episodes of a trial so far, or over the last `last`; in constant memory."""
        rows = self._query(
            """SELECT count(*), ifnull(sum(steps), 0), ifnull(sum(NOT terminal), 0),
                sum(episode_return), count(episode_return) FROM
                (SELECT * FROM episodes WHERE trial = (SELECT key FROM trials WHERE id = ?)
                ORDER BY episode DESC LIMIT ?)""",
            trial_id,
            -1 if last is None else last,
        )
        self._check(rows, (_WHOLE, _WHOLE, _WHOLE, _NUMBER_OR_NULL, _WHOLE))
        (episodes, steps, cut_off, total, numbers) = rows[0]
        if not episodes:
            total = 0.0
        elif numbers < episodes or total is None:  # the sum of infinities of both signs is NaN
            total = math.nan
        return Totals(episodes, steps, cut_off, total)

    def checkpoint(self, trial_id: str) -> tuple[int, Checkpoint] | None:
        """Return the newest checkpoint of a trial and the episode after which it was taken, None if none."""
        rows = self._query(
            """SELECT episode, agent, environment, metrics FROM checkpoints
                WHERE trial = (SELECT key FROM trials WHERE id = ?)""",
            trial_id,
        )
        self._check(rows, (_WHOLE, _BYTES, _BYTES, _BYTES))
        return (rows[0][0], Checkpoint(*rows[0][1:])) if rows else None

    def checkpointed(self) -> dict[str, int]:
        """Return the episode after which the newest checkpoint was taken, for each trial that has one."""
        rows = self._query(
            """SELECT id, episode, (SELECT count(*) FROM episodes WHERE trial = key)
                FROM checkpoints JOIN trials ON key = trial"""
        )
        self._check(rows, (_TEXT, _WHOLE, _WHOLE))
        for trial_id, episode, done in rows:
            if not 0 < episode <= done:
                raise self._damaged(f"a checkpoint of {trial_id} follows episode {episode} of {done}")
        return {trial_id: episode for trial_id, episode, _ in rows}

    def voids(self) -> list[Void]:
        """Return the voided attempts, oldest first."""
        rows = self._query(
            "SELECT time, id, episode, why FROM voids JOIN trials ON key = trial ORDER BY voids.rowid"
        )
        self._check(rows, (_NUMBER, _TEXT, _WHOLE, _TEXT), timed=True)
        return [Void(*row) for row in rows]

    def events(self) -> list[RunEvent]:
        """Return the events of the run, oldest first."""
        rows = self._query(
            "SELECT time, id, kind, text FROM events LEFT JOIN trials ON key = trial ORDER BY events.rowid"
        )
        self._check(rows, (_NUMBER, _TEXT_OR_NULL, _TEXT, _TEXT), timed=True)
        return [RunEvent(*row) for row in rows]

    def players(self) -> list[OutsidePlayer]:
        """Return the players that joined from outside, oldest first."""
        rows = self._query(
            """SELECT time, id, role, name, program FROM players JOIN trials ON key = trial
                ORDER BY players.rowid"""
        )
        self._check(rows, (_NUMBER, _TEXT, _TEXT, _TEXT, _TEXT_OR_NULL), timed=True)
        return [OutsidePlayer(*row) for row in rows]

    def metric_names(self) -> list[str]:
        """Return the names of all metrics of the run, sorted."""
        rows = self._query("SELECT names FROM metric_names")
        self._check(rows, (_TEXT,))
        return sorted({name for (names,) in rows for name in names.split("\n")})

    def metrics(self, trial_id: str) -> dict[str, Metric]:
        """Return the metrics of a trial so far, by name, sorted."""
        try:
            return unpacked((names, data) for _, names, data in self.readings(trial_id))
        except ValueError as error:
            raise self._damaged(str(error)) from None

    def readings(self, trial_id: str) -> list[tuple[int, str, bytes]]:
        """Return the readings of a trial as they are stored: last episode, names and data of each block."""
        rows = self._query(
            """SELECT episode, metric_names.names, data FROM readings
                JOIN metric_names ON metric_names.key = readings.names
                WHERE trial = (SELECT key FROM trials WHERE id = ?) ORDER BY episode, readings.names""",
            trial_id,
        )
        self._check(rows, (_WHOLE, _TEXT, _BYTES))
        return rows

    def answers(self, trial_id: str) -> list[Answered]:
        """Return the answers of a trial's agent after its episodes, in their order."""
        return self._answers("id = ? ORDER BY episode, message", trial_id)

    def newest_answers(self) -> list[Answered]:
        """Return the latest answers of each trial's agent."""
        return self._answers(
            "episode = (SELECT max(episode) FROM answers WHERE trial = key) ORDER BY key, message"
        )

    def outcomes(self) -> dict[str, TrialEnd]:
        """Return the outcome of each finished trial of a competition, by id."""
        rows = self._query("SELECT id, reason, digest FROM outcomes JOIN trials ON key = trial")
        self._check(rows, (_TEXT, _TEXT_OR_NULL, _BYTES))
        return {trial_id: TrialEnd(reason, digest) for trial_id, reason, digest in rows}

    def verdicts(self) -> dict[str, ReplayVerdict]:
        """Return the result of each trial of a competition that was replayed, by id."""
        rows = self._query("SELECT id, digest, problem, score FROM verdicts JOIN trials ON key = trial")
        self._check(rows, (_TEXT, _BYTES, _TEXT_OR_NULL, _NUMBER_OR_NULL))
        return {
            trial_id: ReplayVerdict(digest, problem, math.nan if score is None else score)
            for trial_id, digest, problem, score in rows
        }

    def _answers(self, which: str, *values: object) -> list[Answered]:
        rows = self._query(
            f"SELECT id, episode, message, answer FROM answers JOIN trials ON key = trial WHERE {which}",
            *values,
        )
        self._check(rows, (_TEXT, _WHOLE, _TEXT, _TEXT))
        return [Answered(*row) for row in rows]

    def _query(self, statement: str, *values: object) -> list[Any]:
        with reported(f"cannot read {self.directory}"):
            return self._database.query(statement, *values)

    def _check(
        self,
        rows: Sequence[Sequence[object]],
        types: Sequence[_Types],
        *,
        numbered: bool = False,
        timed: bool = False,
    ) -> None:
        """Check the types of each column and, if asked to, that the first counts from 1 or is a time."""
        columns: list[tuple[Any, ...]] = list(zip(*rows, strict=True))
        for column, allowed in zip(columns, types, strict=False):
            for found in set(map(type, column)).difference(allowed):
                raise self._damaged(f"a {found.__name__} where a {allowed[0].__name__} was expected")
        if not columns:
            return
        if numbered and columns[0] != tuple(range(1, len(rows) + 1)):
            raise self._damaged("episodes of a trial are missing")
        if timed and not (min(columns[0]) >= 0 and max(columns[0]) <= _LAST_SECOND):
            raise self._damaged("a time out of range")

    def _trial(
        self,
        trial_id: str,
        agent: str | None,
        environment: str | None,
        episodes: int,
        max_steps: int,
        seed: int,
        budget: int,
        done: int,
        voids: int,
        steps: int,
        failure: str | None,
    ) -> TrialRecord:
        for name, value in (
            ("episodes", episodes),
            ("steps", budget),
            ("max_steps", max_steps),
            ("seed", seed),
        ):
            if value not in COUNTS[name]:
                raise self._damaged(f"{value} for the {name} of {trial_id}")
        roles = (self._role(trial_id, agent), self._role(trial_id, environment))
        spec = TrialSpec(TrialId(trial_id), *roles, episodes, max_steps, seed, budget)
        return TrialRecord(spec, done, voids, failure, steps)

    def _role(self, trial_id: str, text: str | None) -> RoleSpec | None:
        if text is None:
            return None
        try:
            match json.loads(text):
                case {"name": str(name), "options": dict(options), "label": str(label)} if _are_values(
                    options.values()
                ):
                    return RoleSpec(name, options, label)
        except (ValueError, RecursionError):
            pass
        raise self._damaged(f"the agent or environment of {trial_id} cannot be read")

    def _damaged(self, what: str) -> ExperimentError:
        return ExperimentError(f"cannot read {self.directory}: results.sqlite is damaged: {what}")


def _are_values(values: Collection[object]) -> bool:
    return all(
        isinstance(value, (float, str)) or (isinstance(value, int) and -(2**63) <= value < 2**63)
        for value in values
    )
