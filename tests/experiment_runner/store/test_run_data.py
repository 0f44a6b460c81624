from __future__ import annotations

import math
import sys
from pathlib import Path

import numpy as np
import pytest

import glue
from experiment_runner.executors.opening import open_run
from experiment_runner.plan.plan import Plan, RoleSweep
from experiment_runner.store.records import EpisodeResult
from experiment_runner.store.run_data import StoredRun, load_run
from glue.errors import ExperimentError

PLAN = Plan(
    episodes=3,
    environments=(RoleSweep("mines", {"windy": True}),),
    agents=(RoleSweep("random"), RoleSweep("sarsa", {"step_size": (1, 0.5), "traces": 3, "note": "a"})),
)
RANDOM, WHOLE, HALF = PLAN.expand()


@pytest.fixture
def run(tmp_path: Path) -> StoredRun:
    with open_run(tmp_path / "run", PLAN) as store:
        store.record(RANDOM.id, EpisodeResult(1, math.nan, 7, True, 0.25))
        store.record(RANDOM.id, EpisodeResult(2, -1.5, 8, False, 0.5))
        store.record(HALF.id, EpisodeResult(1, math.inf, 9, True, 0.125))
    return load_run(str(tmp_path / "run"))


def test_columns_are_arrays_of_the_episodes(run: StoredRun) -> None:
    assert run["trial"].tolist() == [RANDOM.id, RANDOM.id, HALF.id]
    assert run["episode"].tolist() == [1, 2, 1]
    np.testing.assert_array_equal(run["return"], [math.nan, -1.5, math.inf])
    assert run["steps"].tolist() == [7, 8, 9]
    assert run["terminal"].tolist() == [True, False, True]
    assert run["wall_time"].tolist() == [0.25, 0.5, 0.125]
    assert run["seed"].tolist() == [RANDOM.seed, RANDOM.seed, HALF.seed]
    assert run["agent"].tolist() == ["random", "random", "sarsa"]
    assert run["environment.windy"].tolist() == [True] * 3
    assert run["agent.note"].tolist() == ["", "", "a"]
    for name, value in (("agent.step_size", 0.5), ("agent.traces", 3.0)):
        np.testing.assert_array_equal(run[name], [math.nan, math.nan, value])
    kinds = {name: array.dtype.kind for name, array in run.items()}
    assert (kinds["trial"], kinds["episode"], kinds["return"], kinds["terminal"]) == ("U", "i", "f", "b")


def test_trials_say_how_far_they_are(run: StoredRun) -> None:
    assert [(trial.spec, trial.done) for trial in run.trials] == [(RANDOM, 2), (WHOLE, 0), (HALF, 1)]
    assert "3 trials, 3 episodes" in repr(run)


def test_data_frame_has_a_row_for_each_episode(run: StoredRun) -> None:
    pytest.importorskip("pandas")
    frame = run.to_pandas()
    assert list(frame.columns) == list(run)
    assert frame.groupby("agent")["steps"].mean().to_dict() == {"random": 7.5, "sarsa": 9.0}


def test_polars_has_the_same_columns(run: StoredRun) -> None:
    pytest.importorskip("polars")
    frame = run.to_polars()
    assert frame.columns == list(run)
    assert frame.filter(agent="sarsa")["steps"].to_list() == [9]
    for name, values in run.items():
        np.testing.assert_array_equal(frame[name].to_numpy(), values)


@pytest.mark.parametrize("library", ["pandas", "polars"])
def test_without_the_library_it_says_what_to_install(
    library: str, run: StoredRun, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, library, None)
    with pytest.raises(ExperimentError, match=rf"pip install 'glue-rl\[{library}\]'"):
        getattr(run, f"to_{library}")()


def test_run_without_episodes_has_empty_columns(tmp_path: Path) -> None:
    open_run(tmp_path / "run", PLAN).close()
    run = load_run(tmp_path / "run")
    assert {array.shape for array in run.values()} == {(0,)}


def test_glue_loads_a_run_through_the_entry_point(run: StoredRun) -> None:
    loaded = glue.load_run(run.directory)
    assert isinstance(loaded, glue.RunData)
    assert loaded.directory == run.directory
    assert list(loaded) == list(run)
    np.testing.assert_array_equal(loaded["return"], run["return"])
