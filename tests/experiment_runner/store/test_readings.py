"""The readings of metrics in the database."""

from __future__ import annotations

import contextlib
import math
import sqlite3
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from experiment_runner.plan.plan import Plan, RoleSweep
from experiment_runner.store.records import Checkpoint, EpisodeResult, Reading
from experiment_runner.store.results import Results
from experiment_runner.store.store import Store
from glue.errors import ExperimentError

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
