"""The numbers on the page are those of glue-plot and glue-results, and few enough for a browser."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from experiment_runner.analysis.curves import over_episodes, over_steps
from experiment_runner.analysis.stats import bootstrap_rng, estimate, mean, running_mean
from experiment_runner.plan import RoleSpec, TrialSpec
from experiment_runner.report.overview import as_object
from experiment_runner.store.records import EpisodeResult
from experiment_runner.store.results import Results
from experiment_runner.store.store import Store
from tests.experiment_runner.view.pages import Page, glue_view

NAME = "<script>alert(1)</script>"
TRIALS, EPISODES = 3, 600
RNG = np.random.default_rng(7)
RETURNS = RNG.normal(size=(TRIALS, EPISODES)).cumsum(axis=1)
STEPS = RNG.integers(1, 50, size=(TRIALS, EPISODES))


def store_run(directory: Path, name: str = NAME, all_returns: Any = RETURNS) -> None:
    agent, environment = RoleSpec(f"{name[1]}.py:A", label=name), RoleSpec("mines", label="mines")
    specs = [
        TrialSpec(f"{name[1]}/mines/{i}", agent, environment, EPISODES, 0, 2**62 + i) for i in range(TRIALS)
    ]
    with Store.create(directory, specs, {}) as store:
        for spec, returns, steps in zip(specs, all_returns, STEPS, strict=True):
            for i, (total, length) in enumerate(zip(returns, steps, strict=True)):
                store.record(spec.id, EpisodeResult(i + 1, float(total), int(length), True, 0.0))


@pytest.fixture(scope="module")
def shown(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Page, Path, str]]:
    directory = tmp_path_factory.mktemp("runs") / "a"
    store_run(directory)
    with glue_view(directory.parent) as page:
        (run,) = page.stream("topic=runs").next()["runs"].values()
        assert run["agents"] == [NAME]
        yield page, directory, run["id"]


def curve_of(shown: tuple[Page, Path, str], query: str = "") -> tuple[dict[str, Any], dict[str, Any]]:
    page, _, run_id = shown
    answer = page.ask(f"/api/curves?run={run_id}{query}")
    assert answer.status == 200
    assert answer.headers["content-type"] == "application/json"
    assert len(answer.body) < 200_000
    found = answer.json()
    (curve,) = found["curves"]
    return found, curve


def test_a_curve_is_that_of_glue_plot(shown: tuple[Page, Path, str]) -> None:
    found, curve = curve_of(shown)
    assert found["window"] == 60  # a tenth, as glue-plot has it
    means = running_mean(RETURNS, 60)
    at = np.unique(np.linspace(0, means.shape[1] - 1, 400).astype(int))
    value, low, high = estimate([means[:, at]], mean, bootstrap_rng())
    assert curve["label"] == NAME
    assert curve["at"] == (at + 60).tolist()
    assert curve["mean"] == value.tolist()
    assert curve["low"] == low.tolist()
    assert curve["high"] == high.tolist()
    assert curve["singles"] == means[:, at].tolist()


def test_the_table_is_that_of_glue_results(shown: tuple[Page, Path, str]) -> None:
    found, _ = curve_of(shown)
    with Results.open(shown[1]) as results:
        assert found["settings"] == as_object(results)["settings"]


def test_a_part_is_shown_with_the_same_numbers_in_more_detail(shown: tuple[Page, Path, str]) -> None:
    _, whole = curve_of(shown)
    _, part = curve_of(shown, "&from=100&to=200")
    assert part["at"] == list(map(float, range(100, 201)))
    known = dict(zip(whole["at"], whole["mean"], strict=True))
    both = [(known[at], value) for at, value in zip(part["at"], part["mean"], strict=True) if at in known]
    assert both
    assert [old for old, _ in both] == [new for _, new in both]


def test_over_steps_each_trial_counts_where_it_was_after_so_many_steps() -> None:
    curve = over_steps(np.array([[1.0, 3.0], [2.0, 6.0]]), [np.array([2, 4]), np.array([4, 8])], 1, RNG)
    assert curve is not None
    assert curve.at.tolist() == [4.0, 5.0, 6.0]
    np.testing.assert_allclose(curve.means, [[2.0, 2.5, 3.0], [2.0, 2.5, 3.0]])
    assert over_steps(np.ones((1, 3)), [np.ones(3, np.int64)], 5, RNG) is None
    assert over_episodes(np.ones((1, 3)), 1, RNG, (7, 9)) is None


def test_many_trials_still_fit(tmp_path: Path) -> None:
    from experiment_runner.view.curves import _as_json

    curve = over_episodes(RNG.normal(size=(300, 1000)), 100, RNG)
    assert curve is not None
    shown = _as_json("a", curve)
    assert sum(map(len, shown["singles"])) <= 8000
    assert len(shown["singles"]) == 300


@pytest.mark.parametrize("query", ["&window=x", "&window=0", "&over=time", "&from=nan"])
def test_what_there_is_not_is_an_error_for_people(shown: tuple[Page, Path, str], query: str) -> None:
    page, _, run_id = shown
    answer = page.ask(f"/api/curves?run={run_id}{query}")
    assert answer.status == 422
    assert answer.json()["error"]
    assert page.ask("/api/curves?run=0").status == 404
    assert page.ask("/api/curves").status == 404
    assert page.ask(f"/api/standings/{run_id}").status == 422
