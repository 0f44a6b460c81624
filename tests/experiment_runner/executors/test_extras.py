"""An environment's extras, from its steps to the columns of a run, in each way of playing a trial."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner, Result

from agents.mario.runner import RunRightAgent
from experiment_runner.cli.experiment import experiment
from experiment_runner.cli.plot import plot
from experiment_runner.cli.results import results as results_command
from experiment_runner.executors.recording import Extras, Meter
from experiment_runner.plan.file import dump_plan, parse_plan
from experiment_runner.plan.limits import REMOTE, TrialId
from experiment_runner.plan.metrics import SUMMARIES, MetricsPlan, Summary, check_extras
from experiment_runner.plan.plan import RoleSpec, TrialSpec, differences
from experiment_runner.plan.toml import SettingError
from experiment_runner.store.records import TOTAL_REWARD, EpisodeResult
from experiment_runner.store.results import Results
from experiment_runner.store.run_data import episode_table, load_run
from glue import Action, ConfigError, Environment, Experiment, ExperimentError, Observation, Step, local
from glue.trajectory import TrajectoryReader, TrajectoryWriter
from tests.experiment_runner.executors.test_trial import play
from tests.hubs import over_the_hub

HEIGHTS = ((2.0, 5.0, 1.0), (4.0, -1.0))


class Climbing(Environment):
    """Tells the height at each observation but the first; the whole climb, and how it ended, at the last."""

    env_extras = True

    def __init__(self) -> None:
        self._episode = -1

    def env_init(self) -> str:
        return ""

    def env_start(self) -> Observation:
        self._episode = (self._episode + 1) % len(HEIGHTS)
        self._step = 0
        return Observation([0], extras={"steps": 0, "extra.steps": 7})

    def env_step(self, action: Action) -> Step:
        heights = HEIGHTS[self._episode]
        extras: dict[str, Any] = {"height": heights[self._step], "steps": self._step + 1}
        self._step += 1
        over = self._step == len(heights)
        if over:
            extras |= {"end": "tired", "climb": [*heights]}
        return Step(0.0, Observation([self._step], extras=extras), over)


Glue = Callable[[Any, Environment], AbstractContextManager[Experiment]]
SPEC = TrialSpec(TrialId("t"), None, RoleSpec("climbing"), 2, 0, 1)
PLAN: dict[str, Summary] = {"climbing.height": "max", "steps": "last", "other.height": "min"}


@pytest.mark.parametrize("glue", [local, over_the_hub])
@pytest.mark.parametrize("records", [False, True])
def test_each_episode_has_a_number_of_each_extra(glue: Glue, records: bool, tmp_path: Path) -> None:
    path = tmp_path / "recording"
    with (
        TrajectoryWriter(path) if records else nullcontext() as writer,
        glue(RunRightAgent(), Climbing()) as connected,
    ):
        kept = play(connected, spec=SPEC, recording=writer, extras=PLAN, metrics=MetricsPlan(2))
    assert [reading for reading in kept.readings if TOTAL_REWARD not in reading.values] == [
        (3, {"climbing.height": 5.0, "climbing.steps": 3.0}),
        (5, {"climbing.height": 4.0, "climbing.steps": 2.0}),
    ]
    assert [reading.step for reading in kept.readings if TOTAL_REWARD in reading.values] == [2, 4]
    assert kept.events.count("unmetered") == 1  # the agent has no metrics
    if records:
        first, _ = TrajectoryReader(path)
        seen = first.steps[0].observation
        assert seen is not None
        assert seen.extras == {"height": 2.0, "steps": 1}


def test_an_episode_is_summed_up_in_six_ways() -> None:
    for how, expected in zip(SUMMARIES, (2.0, 1.0, 8.0, 8 / 3, 1.0, 5.0), strict=True):
        extras = Extras({"height": how}, "climbing")
        for episode in range(2):
            extras.begin()
            assert extras.numbers() == {}
            for height in HEIGHTS[0]:
                extras.see(Observation(extras={"height": height, "unasked": 1}))
            assert extras.numbers() == {"climbing.height": expected}, episode
            assert [*extras.missing()] == []


def test_what_is_not_recorded_is_explained() -> None:
    extras = Extras({"hight": "max"}, "climbing")
    extras.see(Observation(extras={"height": 1.0}))
    (hight,) = extras.missing()
    assert "sent no extra hight" in hight


@pytest.mark.parametrize("value", ["tired", b"tired", [1, 2]])
def test_what_is_no_number_cannot_be_a_metric(value: Any) -> None:
    extras = Extras({"end": "last"}, "climbing")
    with pytest.raises(ExperimentError, match=r"end of climbing .* not a number; .* extras: height, steps$"):
        extras.see(Observation(extras={"height": 1.0, "end": value, "steps": 3}))
    extras.see(Observation(extras={"end": 1}))
    extras.see(Observation(extras={"end": value}))  # not for ever
    assert extras.numbers() == {"climbing.end": 1.0}


@pytest.mark.parametrize(
    ("label", "name", "stored"),
    [
        ("mario", "mario.coins", "mario.coins"),
        ("hard", "mario.coins", "hard.mario.coins"),
        (REMOTE, "mario.coins", "remote.mario.coins"),
        (REMOTE, "coins", "remote.coins"),
    ],
)
def test_an_environment_may_put_its_name_before_an_extras(label: str, name: str, stored: str) -> None:
    """And the label of one that joins from outside may be any."""
    extras = Extras({"mario.coins": "last"}, label)
    extras.see(Observation(extras={name: 3}))
    assert extras.numbers() == {stored: 3.0}
    assert [*extras.missing()] == []


TWO = {"left.speed": 1, "right.speed": 3}


@pytest.mark.parametrize(
    ("label", "sent", "keys", "stored"),
    [
        (REMOTE, TWO, ["left.speed"], {"remote.left.speed": 1}),
        (REMOTE, TWO, ["right.speed", "left.speed"], {"remote.right.speed": 3, "remote.left.speed": 1}),
        (REMOTE, {"speed": 2}, ["left.speed", "speed"], {"remote.speed": 2}),
        (REMOTE, {"speed": 2}, ["left.speed", "right.speed"], {}),
        ("col", {"steps": 1, "col.steps": 3}, ["steps"], {"col.steps": 1}),
        ("col", {"steps": 1, "col.steps": 3}, ["col.col.steps"], {"col.col.steps": 3}),
    ],
)
def test_extras_whose_names_end_alike_are_not_mixed(
    label: str, sent: dict[str, int], keys: list[str], stored: dict[str, int]
) -> None:
    check_extras(keys, [label])
    extras = Extras(dict.fromkeys(keys, "mean"), label)
    extras.see(Observation(extras=sent))
    assert extras.numbers() == stored
    assert len([*extras.missing()]) == len(keys) - len(stored)


@pytest.mark.parametrize("order", [1, -1])
def test_another_extra_that_ends_like_one_sent_at_some_steps_is_not_recorded(order: int) -> None:
    extras = Extras({"left.speed": "last"}, REMOTE)
    sent: list[dict[str, Any]] = [{"speed": 9}, {"left.speed": 1, "speed": 9}]
    for stored in ({"remote.left.speed": 1}, {"remote.speed": 9}):  # each episode by itself
        extras.begin()
        for values in sent[::order]:
            extras.see(Observation(extras=values))
        assert extras.numbers() == stored
        assert [*extras.missing()] == []
        del sent[1:]


def test_an_attempt_that_became_void_leaves_nothing() -> None:
    with local(RunRightAgent(), Climbing()) as glue:
        glue.rl_init(1)
        meter = Meter(glue, None, extras=Extras({"height": "max"}, "climbing"))
        meter.begin()
        glue.rl_start()
        meter.see(glue.rl_step().observation)
        meter.see(Observation(extras={"height": 99}))
        meter.begin()
        assert meter.rl_episode(0)
        assert meter.save() == b""
        (reading,) = meter.end(EpisodeResult(1, 0.0, 2, True, 0.0))
    assert reading.values == {"climbing.height": 4.0}


def measured(out: Path, *metrics: str) -> Result:
    """Run both episodes twice, by the command, with these metrics."""
    names = (f"--env={__file__}:Climbing", "--agent=run-right")
    options = (*(f"--metric={metric}" for metric in metrics), "--in-process", f"--out={out}")
    result = CliRunner().invoke(experiment, [*names, "--episodes=4", *options], standalone_mode=False)
    assert result.exception is None
    return result


@pytest.fixture
def run(tmp_path: Path) -> Path:
    measured(tmp_path / "run", "Climbing.height=max", "steps=sum", "extra.steps=first")
    return tmp_path / "run"


def test_a_run_has_a_column_for_each_extra(run: Path) -> None:
    data = load_run(run)
    columns = [*data]
    after = columns.index("extra.extra.steps")
    assert columns[after:][:4] == ["extra.extra.steps", "extra.steps", "height", "seed"]
    assert data["extra.extra.steps"].tolist() == [7.0] * 4
    assert data["height"].tolist() == [5.0, 4.0, 5.0, 4.0]
    assert data["extra.steps"].tolist() == [6.0, 3.0, 6.0, 3.0]
    with Results.open(run) as results:
        types, trials = episode_table(results)
        assert types["height"] is float
        height = [*types].index("height")
        assert [row[height] for rows in trials for row in rows] == [5.0, 4.0, 5.0, 4.0]
        assert [event.text for event in results.events() if event.kind == "unmetered"] == []


def test_a_metric_of_another_label_than_any_here_is_named_at_the_end(tmp_path: Path) -> None:
    metrics = ("Climbign.height=max", "Climbing.steps=sum", "Climbing.hight=max")
    result = measured(tmp_path / "run", *metrics)
    said = "metric Climbign.height never had a value: no such extra came from Climbing"
    assert [line for line in result.output.splitlines() if "never had" in line] == [said]
    assert said in CliRunner().invoke(results_command, ["show", str(tmp_path / "run")]).output


def test_an_extra_is_plotted_by_the_name_of_its_column(run: Path, tmp_path: Path) -> None:
    for over in ("episodes", "steps"):
        arguments = [str(run), "--y", "height", "--over", over, "--out", str(tmp_path / f"{over}.svg")]
        assert CliRunner().invoke(plot, arguments, standalone_mode=False).exception is None
        assert "height" in (tmp_path / f"{over}.svg").read_text()
    assert "5" in CliRunner().invoke(plot, [str(run), "--y", "height"]).output
    assert "did you mean height" in CliRunner().invoke(plot, [str(run), "--y", "hight"]).output


def test_a_plan_has_a_table_of_extras() -> None:
    text = 'episodes = 1\n[extras]\nmario.coins = "last"\nscore = "mean"\n"a b" = "min"\n'
    plan = parse_plan(text)
    assert plan.extras == {"mario.coins": "last", "score": "mean", "a b": "min"}
    assert parse_plan(dump_plan(plan)) == plan
    assert differences(plan, replace(plan, extras={})) == [f"extras are {{}}, not {plan.extras}"]
    for wrong, message in (
        ("extras = 3", "extras must be a table"),
        ('[extras]\nscore = "lats"', "of the extra 'score' .* not 'lats'; did you mean last"),
        ("[extras]\nmario.coins = 1", "of the extra 'mario.coins'"),
    ):
        with pytest.raises(SettingError, match=message):
            parse_plan(f"episodes = 1\n{wrong}")


@pytest.mark.parametrize(
    ("environments", "key", "label"),
    [("", "remote.score", REMOTE), ('[environments.mines]\nclass = "mines"\n', "mines.score", "mines")],
)
def test_one_number_is_recorded_of_an_extra(environments: str, key: str, label: str) -> None:
    plan = f'episodes = 1\n{environments}[extras]\nscore = "mean"\n{key} = "max"\n'
    with pytest.raises(SettingError, match=f"{key} are the same extra of {label}"):
        parse_plan(plan)


@pytest.mark.parametrize("metric", ["coins", "=last", "coins=", "coins=lats", "score=max"])
def test_a_metric_of_another_form_or_a_second_of_an_extra_is_refused(metric: str) -> None:
    command = ["--env=mines", "--agent=random", "--episodes=1", "--metric=score=min", f"--metric={metric}"]
    refusal = "score and score are the same extra, and" if "score" in metric else "coins=last|extra 'coins'"
    with pytest.raises(ConfigError, match=refusal):
        CliRunner().invoke(experiment, command, standalone_mode=False, catch_exceptions=False)
