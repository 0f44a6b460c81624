from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from experiment_runner.analysis.settings import Setting, collect
from experiment_runner.executors.opening import open_run
from experiment_runner.plan.file import parse_plan
from experiment_runner.plan.plan import Plan, RoleSweep
from experiment_runner.report.comparing import compared, left_out, needed
from experiment_runner.report.overview import as_text, setting_numbers
from experiment_runner.store.records import EpisodeResult
from experiment_runner.store.results import Results
from experiment_runner.store.store import Store
from glue.errors import ExperimentError


def make_run(directory: Path, text: str, lengths: list[int] | None = None) -> Results:
    """Make a run with these numbers of episodes in its trials; episode e of trial t has return 100 t + e."""
    plan = parse_plan(text)
    with open_run(directory, plan) as store:
        for number, (spec, length) in enumerate(zip(plan.expand(), lengths or [], strict=False)):
            for episode in range(1, length + 1):
                store.record(spec.id, EpisodeResult(episode, 100.0 * number + episode, 1, True, 0.0))
    return Results.open(directory)


def labels(settings: list[Setting]) -> list[str]:
    return [setting.label for setting in settings]


def test_trials_that_differ_in_their_seed_are_one_setting(tmp_path: Path) -> None:
    text = "episodes = 3\ntrials = 2\n[environments.mario]\n[agents.random]\n[agents.sample]"
    with make_run(tmp_path / "a", text, [3, 1, 0, 2]) as run:
        random, sample = collect([run])
    assert (random.agent, random.environment, random.label) == ("random", "", "random")
    assert [record.done for record in random.trials] == [3, 1]
    assert [returns.tolist() for returns in random.values] == [[1, 2, 3], [101]]
    assert [returns.tolist() for returns in sample.values] == [[], [301, 302]]


def test_labels_contain_only_what_varies(tmp_path: Path) -> None:
    text = """
        episodes = 1
        [environments.mario]
        level_seed = [1, 2]
        width = 320
        [agents.sample]
        [agents.sarsa]
        step_size = [0.1, 0.3]
        discount = 0.9
        """
    with make_run(tmp_path / "a", text) as run:
        settings = collect([run])
    assert labels(settings) == [
        "sample, mario level_seed=1",
        "sample, mario level_seed=2",
        "sarsa step_size=0.1, mario level_seed=1",
        "sarsa step_size=0.1, mario level_seed=2",
        "sarsa step_size=0.3, mario level_seed=1",
        "sarsa step_size=0.3, mario level_seed=2",
    ]
    assert [setting.agent for setting in settings[2:4]] == ["sarsa step_size=0.1"] * 2


def test_settings_of_several_runs_are_distinguished_or_joined(tmp_path: Path) -> None:
    common = "trials = 2\n[environments.mario]\n[agents.sarsa]\nstep_size = "
    with (
        make_run(tmp_path / "a", f"episodes = 1\n{common} 0.1") as first,
        make_run(tmp_path / "b", f"episodes = 1\n{common} 0.2") as other_option,
        make_run(tmp_path / "c", f"episodes = 9\n{common} 0.1") as longer,
        make_run(tmp_path / "d", f"episodes = 1\nseed = 1\n{common} 0.1") as other_seed,
    ):
        assert labels(collect([first, other_option])) == ["sarsa step_size=0.1", "sarsa step_size=0.2"]
        assert labels(collect([first, longer])) == ["sarsa, mario episodes=1", "sarsa, mario episodes=9"]
        (joined,) = collect([first, other_seed])
        assert (joined.label, len(joined.trials)) == ("sarsa", 4)


def test_option_may_be_called_label(tmp_path: Path) -> None:
    text = "episodes = 1\n[agents.gym]\nlabel = ['x', 'y']"
    with make_run(tmp_path / "a", text) as run:
        assert labels(collect([run])) == ["gym label=x", "gym label=y"]


def test_trial_given_twice_is_refused(tmp_path: Path) -> None:
    message = r"trial remote/remote/0 is in .*/a and in .*/a"
    with make_run(tmp_path / "a", "episodes = 1") as run:
        again = Results.open(tmp_path / "a")
        with again, pytest.raises(ExperimentError, match=message):
            collect([run, again])


@pytest.mark.parametrize(
    ("lengths", "curves"),
    [
        ([2, 1, 2], [[1, 2], [201, 202]]),  # the finished ones, in full
        ([1, 1, 0], [[1], [101]]),  # none finished: those that have begun, up to the length of the shortest
        ([0, 0, 0], []),
    ],
)
def test_curves_are_as_long_as_can_be(tmp_path: Path, lengths: list[int], curves: list[list[float]]) -> None:
    with make_run(tmp_path / "a", "episodes = 2\ntrials = 3", lengths) as run:
        (setting,) = collect([run])
    assert setting.curves().ndim == 2
    assert setting.curves().tolist() == curves


def test_failed_trial_counts_in_no_mean_and_that_is_said(tmp_path: Path) -> None:
    text = "episodes = 2\ntrials = 3"
    with make_run(tmp_path / "a", text, [2, 1, 2]) as a, make_run(tmp_path / "b", text, [1, 1, 1]) as b:
        store = Store.open(tmp_path / "a")
        store.record_failure("remote/remote/1", "it broke")
        store.close()
        (setting,) = collect([a])
        assert setting.counted() == [0, 2]
        assert setting_numbers([setting])[0]["mean"] == np.mean([1, 2, 201, 202])
        assert "1 failed trial left out of the means" in as_text([a])
        (row,) = compared(a, b, "episodes")
        assert row.found.trials == 2
        assert [cells[1] for cells in needed(a, 10.0, 0.8, "episodes")] == ["2"]
        assert left_out(a, b) == [
            f"1 failed trial of {tmp_path / 'a'} left out",
            f"3 trials of {tmp_path / 'b'} not finished",
        ]


def test_players_from_outside_are_called_by_the_names_that_they_gave(tmp_path: Path) -> None:
    plan = Plan(episodes=1, environments=(RoleSweep("mines"),))
    runs = []
    for name in ("Jumper", "Walker"):
        with open_run(tmp_path / name, plan) as store:
            store.record_player("remote/mines/0", "agent", name, "Python 3.11.7")
        runs.append(Results.open(tmp_path / name))
    assert [setting.label for setting in collect(runs)] == ["Jumper", "Walker"]
    for run in runs:
        run.close()
