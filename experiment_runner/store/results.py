"""Reading a run directory."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Annotated, Any, Final, NamedTuple, Self, TypeVar

import msgspec
import numpy as np
import numpy.typing as npt
from msgspec import Meta

from experiment_runner.plan.limits import COUNTS, TrialId
from experiment_runner.plan.plan import RoleSpec, TrialSpec
from experiment_runner.store import records
from experiment_runner.store.database import Database, open_to_read, reported
from experiment_runner.store.readings import Metric, unpacked
from glue.closing import Closing
from glue.errors import ConfigError, ExperimentError
from glue.pace import Pace

_Row = TypeVar("_Row")
_Whole = Annotated[int, Meta(ge=0)]
_STORED: Final[dict[str, Any]] = {  # types of the measures; NULL for NaN, and if recorded without the measure
    name: int if measure.kind is bool else measure.kind if "NOT NULL" in measure.sql else measure.kind | None
    for name, measure in records.MEASURES.items()
}
_COLUMNS: Final = {name: measure.sql.partition(" ")[0] for name, measure in records.MEASURES.items()}
_OF_TRIAL: Final = "trial = (SELECT key FROM trials WHERE id = ?)"


class _TrialRow(NamedTuple):
    """A trial as the database has it; agent and environment are JSON."""

    trial_id: str
    agent: str | None
    environment: str | None
    episodes: _Whole
    max_steps: Annotated[int, Meta(ge=0, le=COUNTS["max_steps"][-1])]
    seed: _Whole
    budget: _Whole
    rate: float
    late: str
    delay: _Whole
    done: int
    voids: int
    steps: int
    failure: str | None


class _Role(msgspec.Struct):
    """The JSON of an agent or environment."""

    name: str
    options: dict[str, bool | Annotated[int, Meta(ge=-(2**63), le=2**63 - 1)] | float | str]
    label: str


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

    def trials(self) -> list[records.TrialRecord]:
        """Return the record of every trial, in the order of the plan."""
        rows = self._rows(
            _TrialRow,
            """SELECT id, agent, environment, trials.episodes, max_steps, seed, trials.steps,
                rate, late, delay,
                (SELECT count(*) FROM episodes WHERE trial = key), ifnull(voided, 0),
                iif(trials.steps, (SELECT ifnull(sum(steps), 0) FROM episodes WHERE trial = key), 0), failure
                FROM trials LEFT JOIN
                (SELECT trial, count(*) AS voided FROM voids GROUP BY trial) AS v ON v.trial = key
                ORDER BY key""",
        )
        return [self._trial(row) for row in rows]

    def joined_players(self) -> dict[tuple[str, str], str]:
        """Return the name of the last player that joined from outside, by trial and role."""
        return {(player.trial_id, player.role): player.name for player in self.players()}

    def trial_names(self) -> dict[str, str]:
        """Return the name of each trial by its id: the id with the names of players from outside."""
        joined = self.joined_players()
        return {record.spec.id: record.spec.named(joined) for record in self.trials()}

    def episodes(self, trial_id: str) -> list[records.EpisodeResult]:
        """Return the episodes of a trial so far, in order; a return may be NaN."""
        rows = self._numbered(trial_id, *records.MEASURES)
        kinds = [measure.kind for measure in records.MEASURES.values()]
        return [
            records.EpisodeResult._make(
                (episode, *(math.nan if v is None else k(v) for k, v in zip(kinds, values, strict=True)))
            )
            for episode, *values in rows
        ]

    def measure(self, trial_id: str, name: str) -> npt.NDArray[np.float64]:
        """Return one of `MEASURES` for the episodes of a trial so far, shape (episodes,).

        Args:
            trial_id: of the trial.
            name: of a measure that is a number or a bool.
        """
        rows = self._numbered(trial_id, name)
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
        rows = self._rows(
            tuple[int],
            """SELECT trials.steps AND NOT terminal AND trials.steps =
                (SELECT sum(steps) FROM episodes WHERE trial = key) FROM trials JOIN episodes ON trial = key
                WHERE id = ? ORDER BY episode DESC LIMIT 1""",
            trial_id,
        )
        return bool(rows and rows[0][0])

    def totals(self, trial_id: str, last: int | None = None) -> records.Totals:
        """Return sums over the episodes of a trial so far, or over the last `last`; in constant memory."""
        ((episodes, steps, cut_off, total, numbers),) = self._rows(
            tuple[int, int, int, float | None, int],
            f"""SELECT count(*), ifnull(sum(steps), 0), ifnull(sum(NOT terminal), 0),
                sum(episode_return), count(episode_return) FROM
                (SELECT * FROM episodes WHERE {_OF_TRIAL} ORDER BY episode DESC LIMIT ?)""",
            trial_id,
            -1 if last is None else last,
        )
        if not episodes:
            total = 0.0
        elif numbers < episodes or total is None:  # the sum of infinities of both signs is NaN
            total = math.nan
        return records.Totals(episodes, steps, cut_off, total)

    def checkpoint(self, trial_id: str) -> tuple[int, records.Checkpoint] | None:
        """Return the newest checkpoint of a trial and the episode after which it was taken, None if none."""
        rows = self._rows(
            tuple[int, bytes, bytes, bytes],
            f"SELECT episode, agent, environment, metrics FROM checkpoints WHERE {_OF_TRIAL}",
            trial_id,
        )
        return (rows[0][0], records.Checkpoint(*rows[0][1:])) if rows else None

    def checkpointed(self) -> dict[str, int]:
        """Return the episode after which the newest checkpoint was taken, for each trial that has one."""
        rows = self._rows(
            tuple[str, int, int],
            """SELECT id, episode, (SELECT count(*) FROM episodes WHERE trial = key)
                FROM checkpoints JOIN trials ON key = trial""",
        )
        for trial_id, episode, done in rows:
            if not 0 < episode <= done:
                raise self._damaged(f"a checkpoint of {trial_id} follows episode {episode} of {done}")
        return {trial_id: episode for trial_id, episode, _ in rows}

    def voids(self) -> list[records.Void]:
        """Return the voided attempts, oldest first."""
        return self._rows(
            records.Void,
            "SELECT time, id, episode, why FROM voids JOIN trials ON key = trial ORDER BY voids.rowid",
        )

    def events(self) -> list[records.RunEvent]:
        """Return the events of the run, oldest first."""
        return self._rows(
            records.RunEvent,
            "SELECT time, id, kind, text FROM events LEFT JOIN trials ON key = trial ORDER BY events.rowid",
        )

    def players(self) -> list[records.OutsidePlayer]:
        """Return the players that joined from outside, oldest first."""
        return self._rows(
            records.OutsidePlayer,
            """SELECT time, id, role, name, program FROM players JOIN trials ON key = trial
                ORDER BY players.rowid""",
        )

    def metric_names(self) -> list[str]:
        """Return the names of all metrics of the run, sorted."""
        rows = self._rows(tuple[str], "SELECT names FROM metric_names")
        return sorted({name for (names,) in rows for name in names.split("\n")})

    def metrics(self, trial_id: str) -> dict[str, Metric]:
        """Return the metrics of a trial so far, by name, sorted."""
        try:
            return unpacked((names, data) for _, names, data in self.readings(trial_id))
        except ValueError as error:
            raise self._damaged(str(error)) from None

    def readings(self, trial_id: str) -> list[tuple[int, str, bytes]]:
        """Return the readings of a trial as they are stored: last episode, names and data of each block."""
        return self._rows(
            tuple[int, str, bytes],
            f"""SELECT episode, metric_names.names, data FROM readings
                JOIN metric_names ON metric_names.key = readings.names
                WHERE {_OF_TRIAL} ORDER BY episode, readings.names""",
            trial_id,
        )

    def answers(self, trial_id: str) -> list[records.Answered]:
        """Return the answers of a trial's agent after its episodes, in their order."""
        return self._answers("id = ? ORDER BY episode, message", trial_id)

    def newest_answers(self) -> list[records.Answered]:
        """Return the latest answers of each trial's agent."""
        return self._answers(
            "episode = (SELECT max(episode) FROM answers WHERE trial = key) ORDER BY key, message"
        )

    def outcomes(self) -> dict[str, records.TrialEnd]:
        """Return the outcome of each finished trial of a competition, by id."""
        rows = self._rows(
            tuple[str, str | None, bytes],
            "SELECT id, reason, digest FROM outcomes JOIN trials ON key = trial",
        )
        return {trial_id: records.TrialEnd(reason, digest) for trial_id, reason, digest in rows}

    def late_actions(self) -> dict[str, tuple[int, int]]:
        """Return the number of late actions of each trial with a rate, and of all its actions, by id."""
        rows = self._rows(
            tuple[str, int, int],
            "SELECT id, ifnull(SUM(episodes.late), 0), SUM(episodes.steps) FROM episodes "
            "JOIN trials ON key = trial WHERE rate > 0 GROUP BY trial",
        )
        return {trial_id: (late, actions) for trial_id, late, actions in rows}

    def verdicts(self) -> dict[str, records.ReplayVerdict]:
        """Return the result of each trial of a competition that was replayed, by id."""
        rows = self._rows(
            tuple[str, bytes, str | None, float | None],
            "SELECT id, digest, problem, score FROM verdicts JOIN trials ON key = trial",
        )
        return {row[0]: _verdict(*row[1:]) for row in rows}

    def verdict(self, trial_id: str) -> records.ReplayVerdict | None:
        """Return the result of replaying a trial of a competition; None if it was not replayed."""
        rows = self._rows(
            tuple[bytes, str | None, float | None],
            f"SELECT digest, problem, score FROM verdicts WHERE {_OF_TRIAL}",
            trial_id,
        )
        return _verdict(*rows[0]) if rows else None

    def _answers(self, which: str, *values: object) -> list[records.Answered]:
        return self._rows(
            records.Answered,
            f"SELECT id, episode, message, answer FROM answers JOIN trials ON key = trial WHERE {which}",
            *values,
        )

    def _query(self, statement: str, *values: object) -> list[Any]:
        with reported(f"cannot read {self.directory}"):
            return self._database.query(statement, *values)

    def _rows(self, kind: type[_Row], statement: str, *values: object) -> list[_Row]:
        """Return the rows of a query, each as a tuple of this kind, whose values are checked."""
        rows = self._query(statement, *values)
        try:
            return msgspec.convert(rows, list[kind], builtin_types=(bytes,))  # type: ignore[valid-type]
        except msgspec.ValidationError as error:
            raise self._damaged(str(error)) from None

    def _numbered(self, trial_id: str, *measures: str) -> list[Any]:
        """Return the number and some measures of each episode of a trial."""
        columns = ", ".join(_COLUMNS[name] for name in measures)
        kind: Any = tuple[(int, *(_STORED[name] for name in measures))]  # type: ignore[misc]
        statement = f"SELECT episode, {columns} FROM episodes WHERE {_OF_TRIAL} ORDER BY episode"
        rows = self._rows(kind, statement, trial_id)
        if any(row[0] != number for number, row in enumerate(rows, 1)):
            raise self._damaged("episodes of a trial are missing")
        return rows

    def _trial(self, row: _TrialRow) -> records.TrialRecord:
        roles = (self._role(row.trial_id, row.agent), self._role(row.trial_id, row.environment))
        try:
            pace = Pace(row.rate, row.late, row.delay)
        except ConfigError as error:
            raise self._damaged(f"the pace of {row.trial_id}: {error}") from None
        limits = (row.episodes, row.max_steps, row.seed, row.budget)
        spec = TrialSpec(TrialId(row.trial_id), *roles, *limits, pace=pace)
        return records.TrialRecord(spec, row.done, row.voids, row.failure, row.steps)

    def _role(self, trial_id: str, text: str | None) -> RoleSpec | None:
        if text is None:
            return None
        try:
            role = msgspec.convert(json.loads(text), _Role)
        except (ValueError, RecursionError):
            raise self._damaged(f"the agent or environment of {trial_id} cannot be read") from None
        return RoleSpec(role.name, role.options, role.label)

    def _damaged(self, what: str) -> ExperimentError:
        return ExperimentError(f"cannot read {self.directory}: results.sqlite is damaged: {what}")


@contextmanager
def opened(directories: Iterable[Path]) -> Iterator[list[Results]]:
    """Open run directories for reading.

    Raises:
        ExperimentError: there is no run in one of them, or it cannot be read.
    """
    with ExitStack() as stack:
        yield [stack.enter_context(Results.open(directory)) for directory in directories]


def _verdict(digest: bytes, problem: str | None, score: float | None) -> records.ReplayVerdict:
    return records.ReplayVerdict(digest, problem, math.nan if score is None else score)
