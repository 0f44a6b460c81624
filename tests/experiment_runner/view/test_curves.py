"""The numbers on the page are those of glue-plot and glue-results, and few enough for a browser."""

from __future__ import annotations

import json
import math
import re
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest

from experiment_runner.analysis.curves import of_metric, over_episodes
from experiment_runner.analysis.settings import Setting
from experiment_runner.analysis.stats import bootstrap_rng, estimate, mean, running_mean
from experiment_runner.executors.opening import open_run
from experiment_runner.plan.limits import TrialId
from experiment_runner.plan.plan import Plan, RoleSpec, RoleSweep, TrialSpec
from experiment_runner.report.overview import as_object
from experiment_runner.report.svg import Line, draw, sample
from experiment_runner.store.layout import COMPETITION_FILE
from experiment_runner.store.records import MEASURES, EpisodeResult
from experiment_runner.store.results import Results
from experiment_runner.store.store import Store
from experiment_runner.view.catalog import Catalog, address_of, run_id
from experiment_runner.view.curves import Look, Wanted, _as_json, curves, drawn
from experiment_runner.view.stream import as_json
from tests.experiment_runner.view.pages import Inside
from tests.system.runs import run as execute

NAME = "<script>alert(1)</script>"
TRIALS, EPISODES = 3, 600
RNG = np.random.default_rng(7)
RETURNS = RNG.normal(size=(TRIALS, EPISODES)).cumsum(axis=1)
STEPS = RNG.integers(1, 50, size=(TRIALS, EPISODES))


METRIC = "mean TD error"


def store_metrics(directory: Path) -> None:
    """Store a run whose agent reports metrics every 50 steps."""
    plan = ("--env", "mines", "--agent", "sarsa", "--episodes", 60, "--max-steps", 40, "--trials", 2)
    done = execute(*plan, "--metrics-every", 50, "--in-process", "--out", directory, cwd=directory.parent)
    assert done.returncode == 0, done.stderr


def store_run(directory: Path, name: str = NAME, all_returns: Any = RETURNS) -> None:
    agent, environment = RoleSpec(f"{name[1]}.py:A", label=name), RoleSpec("mines", label="mines")
    specs = [
        TrialSpec(TrialId(f"{name[1]}/mines/{i}"), agent, environment, EPISODES, 0, 2**62 + i)
        for i in range(TRIALS)
    ]
    with Store.create(directory, specs, {}) as store:
        for spec, returns, steps in zip(specs, all_returns, STEPS, strict=True):
            for i, (total, length) in enumerate(zip(returns, steps, strict=False)):
                store.record(spec.id, EpisodeResult(i + 1, float(total), int(length), True, 0.0))


@pytest.fixture(scope="module")
def shown(tmp_path_factory: pytest.TempPathFactory) -> tuple[Inside, Path, str]:
    directory = tmp_path_factory.mktemp("runs") / "a"
    store_run(directory)
    page = Inside(directory.parent)
    return page, directory, page.run_id("a")


def curve_of(shown: tuple[Inside, Path, str], query: str = "") -> tuple[dict[str, Any], dict[str, Any]]:
    page, _, run_id = shown
    answer = page.ask(f"/api/curves?run={run_id}{query}")
    assert answer.status == 200
    assert answer.headers["content-type"] == "application/json"
    assert len(answer.body) < 200_000
    found = answer.json()
    (curve,) = found["curves"]
    return found, curve


def test_a_curve_is_that_of_glue_plot(shown: tuple[Inside, Path, str]) -> None:
    found, curve = curve_of(shown)
    assert found["window"] == 60  # a tenth, as in glue-plot
    means = running_mean(RETURNS, 60)
    at = np.unique(np.linspace(0, means.shape[1] - 1, 400).astype(int))
    value, low, high = estimate([means[:, at]], mean, bootstrap_rng())
    assert curve["label"] == NAME
    assert curve["at"] == (at + 60).tolist()
    assert curve["mean"] == value.tolist()
    assert curve["low"] == low.tolist()
    assert curve["high"] == high.tolist()
    drawing = found["drawings"][0]["svg"]
    assert drawing.count('class="curve single') == len(RETURNS)
    assert "NaN" not in drawing.replace("nan", "NaN")


def test_each_environment_has_a_drawing_and_an_agent_one_look(tmp_path: Path) -> None:
    agents, environments = (tuple(RoleSweep(name) for name in names) for names in ("ab", "xy"))
    plan = Plan(episodes=20, environments=environments, agents=agents)
    with open_run(tmp_path / "run", plan) as store:
        for spec in plan.expand():
            for episode in range(1, 21):
                store.record(spec.id, EpisodeResult(episode, 1.0 * episode, 1, True, 0.0))
    found = curves(Wanted((tmp_path / "run",), 2, "episodes", (-math.inf, math.inf)))
    shown = drawn(found, "episodes", Look(900, (False, False)))
    assert [one["environment"] for one in shown["drawings"]] == ["x", "y"]
    labels = [[shown["curves"][i]["label"] for i in one["curves"]] for one in shown["drawings"]]
    assert labels == [["a, x", "b, x"], ["a, y", "b, y"]]
    for one in shown["drawings"]:
        assert 'viewBox="0 0 442 420"' in one["svg"]
        assert re.findall(r'<polyline class="curve (c\d)"', one["svg"]) == ["c0", "c1"]


def test_the_page_begins_with_the_run_or_the_standings_that_it_is_asked_for(tmp_path: Path) -> None:
    with open_run(tmp_path / "run", Plan(episodes=1)) as store:
        assert address_of([tmp_path / "run"]) == f"#/run/{run_id(store.directory)}"
        (store.directory / COMPETITION_FILE).touch()
        assert address_of([tmp_path / "run"]) == f"#/standings/{run_id(store.directory)}"
    assert address_of([tmp_path]) == address_of([tmp_path / "run", tmp_path]) == ""


def test_the_table_is_that_of_glue_results(shown: tuple[Inside, Path, str]) -> None:
    found, _ = curve_of(shown)
    with Results.open(shown[1]) as results:
        assert found["settings"] == as_object(results)["settings"]


def test_another_measure_has_its_own_curve_and_axis_beside_the_table_of_returns(
    shown: tuple[Inside, Path, str],
) -> None:
    returns, _ = curve_of(shown)
    found, curve = curve_of(shown, "&measure=steps")
    with Results.open(shown[1]) as results:
        steps = np.array([results.measure(trial.spec.id, "steps") for trial in results.trials()])
    assert curve["mean"][-1] == pytest.approx(steps[:, -60:].mean())
    assert MEASURES["steps"].label in found["drawings"][0]["svg"]
    assert found["measures"] == list(MEASURES)
    assert found["settings"] == returns["settings"]


def test_a_part_is_shown_with_the_same_numbers_in_more_detail(shown: tuple[Inside, Path, str]) -> None:
    _, whole = curve_of(shown)
    _, part = curve_of(shown, "&from=100&to=200")
    assert part["at"] == list(map(float, range(100, 201)))
    known = dict(zip(whole["at"], whole["mean"], strict=True))
    both = [(known[at], value) for at, value in zip(part["at"], part["mean"], strict=True) if at in known]
    assert both
    assert [old for old, _ in both] == [new for _, new in both]


def test_over_episodes_a_span_beyond_the_end_has_no_curve() -> None:
    assert over_episodes(np.ones((1, 3)), 1, RNG, (7, 9)) is None


def test_many_trials_still_fit() -> None:
    curve = over_episodes(RNG.normal(size=(300, 100)), 10, RNG)
    assert curve is not None
    shown = _as_json(Setting("a", "", (), ()), curve)
    assert sum(map(len, shown["singles"])) <= 8000
    assert len(shown["singles"]) == 300


@pytest.mark.parametrize("query", ["&window=x", "&window=0", "&over=time", "&from=nan"])
def test_what_there_is_not_is_an_error_for_people(shown: tuple[Inside, Path, str], query: str) -> None:
    page, _, run_id = shown
    answer = page.ask(f"/api/curves?run={run_id}{query}")
    assert answer.status == 422
    assert answer.json()["error"]
    assert page.ask("/api/curves?run=0").status == 404
    assert page.ask("/api/curves").status == 404
    assert page.ask(f"/api/standings/{run_id}").status == 422


@pytest.mark.parametrize("query", ["&from=1e999", "&to=-inf", "&over=steps&from=inf"])
def test_a_part_beyond_all_curves_is_empty(shown: tuple[Inside, Path, str], query: str) -> None:
    page, _, run_id = shown
    assert page.ask(f"/api/curves?run={run_id}{query}").json()["curves"] == []


def test_no_two_of_forty_lines_look_the_same() -> None:
    lines = [Line([0, 1], [number, number + 1]) for number in range(42)]
    drawing = draw(lines, ("x", "y"))["svg"]
    looks = re.findall(r'<polyline (.*?) points="', drawing)
    assert len(set(looks)) == len(looks) == 42
    assert [re.findall(r"<polyline (.*?) points=", sample(number))[0] for number in range(42)] == looks


@pytest.mark.parametrize("log", [(False, False), (True, True)])
@pytest.mark.parametrize(
    "values",
    [
        *([0.0, 0.0], [-1e300, 1e300], [1e-300, 1e300], [-5.0, 7.0], [None, 3.0]),
        *([1e308, 1.7e308], [-8e307, 8e307], [0.0, 3e-323]),
    ],
)
def test_any_numbers_are_drawn_inside_the_axes(values: list[float | None], log: tuple[bool, bool]) -> None:
    drawing = draw([Line([1.0, 2.0], values, values, values)], ("x", "y"), log=log)
    left, top, width, height = drawing["box"]
    for points in re.findall(r'points="(.*?)"', drawing["svg"]):
        for x, y in (map(float, point.split(",")) for point in points.split()):
            assert left - 0.1 <= x <= left + width + 0.1
            assert top - 0.1 <= y <= top + height + 0.1


def test_the_label_of_an_axis_is_text() -> None:
    label = f"loss < 1 & {NAME}"
    drawing = ElementTree.fromstring(draw([Line([1.0], [1.0])], ("step", label))["svg"])
    assert [text.text for text in drawing.findall(".//{*}text")][-1] == label


@pytest.mark.parametrize("total", [1.5e308, 1.0])
def test_a_mean_that_exceeds_all_numbers_leaves_the_table_of_runs(tmp_path: Path, total: float) -> None:
    store_run(tmp_path / "run", all_returns=np.full((TRIALS, 1), total))
    (summary,) = Catalog([tmp_path]).changes().values()
    assert summary is not None
    assert json.loads(as_json(summary))["returns"] == [1.0] * (total == 1.0)


def test_a_metric_is_drawn_over_steps(tmp_path: Path) -> None:
    store_metrics(tmp_path / "run")
    page = Inside(tmp_path)
    found = page.ask(f"/api/curves?run={page.run_id('run')}&measure={METRIC.replace(' ', '%20')}").json()
    wrong = page.ask(f"/api/curves?run={page.run_id('run')}&measure=mean%20TD%20eror")
    (curve,) = found["curves"]
    with Results.open(tmp_path / "run") as results:
        readings = [results.metrics(trial.spec.id)[METRIC] for trial in results.trials()]
    expected = of_metric([(each.steps, each.values) for each in readings], bootstrap_rng())
    assert expected is not None
    assert curve["at"] == expected.at.tolist()
    assert curve["mean"] == pytest.approx(expected.band.value.tolist())
    assert METRIC in found["measures"]
    assert wrong.status == 422
    assert f"did you mean {METRIC}" in wrong.body.decode()
