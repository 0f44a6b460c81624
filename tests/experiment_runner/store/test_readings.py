"""The readings of metrics in the database, including those of older versions."""

from __future__ import annotations

import contextlib
import math
import sqlite3
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from experiment_runner.executors.job import Start
from experiment_runner.executors.recording import Meter
from experiment_runner.plan.metrics import Keep, MetricsPlan
from experiment_runner.plan.plan import Plan, RoleSweep
from experiment_runner.store.records import Checkpoint, EpisodeResult, Reading
from experiment_runner.store.results import Results
from experiment_runner.store.schema import MIGRATIONS
from experiment_runner.store.store import Store
from glue import ExperimentError, local
from tests.players import ScriptedAgent, ScriptedEnvironment

PLAN = Plan(episodes=30, trials=2, environments=(RoleSweep("mines", {}),), agents=(RoleSweep("sarsa", {}),))
FIRST, SECOND = (spec.id for spec in PLAN.expand())
READINGS = (
    Reading(5, {"a": 1.5, "b": math.nan}),
    Reading(6, {"a": -math.inf}),
    Reading(7, {"a": 0.1, "b": 2.0}),
    Reading(8, {"b": 3.0, "a": 4.0}),
)


@pytest.fixture
def store(tmp_path: Path) -> Iterator[Store]:
    with Store.create(tmp_path / "run", PLAN.expand(), {}) as store:
        yield store


def result(episode: int) -> EpisodeResult:
    return EpisodeResult(episode, 1.0, 4, True, 0.1)


def values(results: Results, trial_id: str) -> dict[str, list[tuple[float, float, float]]]:
    """Return the metrics of a trial as triples of episode, step, value."""
    return {
        name: list(zip(*map(np.ndarray.tolist, metric), strict=True))
        for name, metric in results.metrics(trial_id).items()
    }


def test_readings_are_read_back_in_the_order_of_their_steps(store: Store) -> None:
    records = [(FIRST, result(n), None, (), (reading,)) for n, reading in enumerate(READINGS, 1)]
    store.record_all([*records[:2], (SECOND, result(1), None, (), READINGS)])
    store.record_all(records[2:])
    assert store.metric_names() == ["a", "b"]
    assert [[*map(str, row)] for row in values(store, FIRST)["a"]] == [
        ["1.0", "5.0", "1.5"],
        ["2.0", "6.0", "-inf"],
        ["3.0", "7.0", "0.1"],
        ["4.0", "8.0", "4.0"],
    ]
    assert str(values(store, FIRST)["b"]) == "[(1.0, 5.0, nan), (3.0, 7.0, 2.0), (4.0, 8.0, 3.0)]"
    assert [value for _, _, value in values(store, SECOND)["a"]] == [1.5, -math.inf, 0.1, 4.0]


def test_readings_after_a_checkpoint_go_with_its_episodes(store: Store) -> None:
    saved = Checkpoint(b"agent")
    store.record_all(
        [
            (FIRST, result(n), saved if n == 2 else None, (), (reading,))
            for n, reading in enumerate(READINGS, 1)
        ]
    )
    store.rewind(FIRST, 2)
    assert values(store, FIRST)["a"] == [(1.0, 5.0, 1.5), (2.0, 6.0, -math.inf)]
    store.rewind(FIRST, 0)
    assert values(store, FIRST) == {}


@pytest.mark.parametrize(
    ("statement", "what"),
    [
        ("UPDATE readings SET data = x'00'", "values of metrics without a name"),
        ("UPDATE readings SET data = x''", "values of metrics without a name"),
        (f"UPDATE readings SET data = x'{32 * 'ff'}'", "no whole number"),
        ("UPDATE readings SET data = 'text'", "got `str`"),
        ("UPDATE metric_names SET names = x'00'", "got `bytes`"),
    ],
)
def test_readings_that_no_run_has_are_one_clear_error(store: Store, statement: str, what: str) -> None:
    store.record_all([(FIRST, result(1), None, (), READINGS[3:])])
    store.close()
    with contextlib.closing(sqlite3.connect(store.directory / "results.sqlite")) as connection:
        connection.execute(statement)
        connection.commit()
    with Results.open(store.directory) as results, pytest.raises(ExperimentError, match=what):
        results.metrics(FIRST)


class Measured(ScriptedAgent):
    """Has the same error at each reading."""

    def agent_metrics(self) -> dict[str, float]:
        return {"error": 4.0}


OLDER = """
INSERT INTO trials VALUES (1, 'one', NULL, NULL, 9, 0, 7, NULL, 0), (2, 'two', NULL, NULL, 9, 0, 7, NULL, 0);
INSERT INTO episodes VALUES (1, 1, 1.0, 4, 1, 0.1), (1, 2, 1.0, 4, 1, 0.1), (1, 3, 1.0, 4, 1, 0.1);
INSERT INTO checkpoints VALUES (1, 2, x'00', x'01'), (2, 1, x'00', x'01');
INSERT INTO metrics VALUES
    (1, 1, 'size', 1, 4, 8.5, 1, 0), (1, 2, 'size', 2, 8, NULL, 1, 0), (1, 3, 'size', 3, 12, 9.5, 1, 0),
    (1, 1, 'error', 1, 4, 1.0, 3, 1), (1, 2, 'error', 2, 8, 2.5, 3, 1), (1, 3, 'error', 3, 12, 4.0, 3, 1);
"""


def test_metrics_of_version_6_are_read_and_averaged_on(tmp_path: Path) -> None:
    with contextlib.closing(sqlite3.connect(tmp_path / "results.sqlite")) as connection:
        for statement in (statement for version in MIGRATIONS[:6] for statement in version):
            assert isinstance(statement, str)
            connection.execute(statement)
        connection.executescript("PRAGMA user_version = 6;" + OLDER)
    with Results.open(tmp_path) as results:
        before = values(results, "one")
        assert before["error"] == [(3.0, 12.0, 2.5)]
        assert str(before["size"]) == "[(1.0, 4.0, 8.5), (2.0, 8.0, nan), (3.0, 12.0, 9.5)]"
    with Store.open(tmp_path) as store:
        assert str(values(store, "one")) == str(before)
        kept = store.checkpoint("one")
        assert kept is not None
        # The group's two values before the checkpoint, for a trial that continues from it.
        plan = MetricsPlan(0, {"error": Keep(3, averaged=True)})
        meter = Meter(local(Measured(), ScriptedEnvironment()), plan, Start(*kept, 8, 2.0))
        meter.begin()
        assert meter.end(EpisodeResult(3, 1.0, 4, True, 0.1)) == (Reading(12, {"error": 2.5}),)
        assert store.checkpoint("two") == (1, Checkpoint(b"\0", b"\1"))
