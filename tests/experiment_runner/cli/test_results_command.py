from __future__ import annotations

import csv
import io
import json
import math
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from click import Context, UsageError
from click.testing import CliRunner, Result
from pyarrow import parquet

from agents.baselines import RandomAgent
from experiment_runner.cli.experiment import experiment
from experiment_runner.cli.plot import plot
from experiment_runner.cli.results import results
from experiment_runner.executors.opening import open_run, recorded_plan, remaining
from experiment_runner.plan.plan import Plan, RoleSweep
from experiment_runner.report.overview import overview
from experiment_runner.store.layout import ABOUT_FILE, PLAN_FILE
from experiment_runner.store.records import Checkpoint, EpisodeResult, TrialEnd
from experiment_runner.store.results import Results
from experiment_runner.store.store import Store
from glue.errors import ConfigError, ExperimentError

PLAN = Plan(
    episodes=4,
    trials=2,
    environments=(RoleSweep("mario", {"level_seed": 121, "slow": False}),),
    agents=(RoleSweep("random"), RoleSweep("sarsa", {"step_size": 0.5, "note": 'a "quote", and é'})),
)
TRIALS = [spec.id for spec in PLAN.expand()]


def result(trial: int, episode: int) -> EpisodeResult:
    return EpisodeResult(episode, 10 * trial + episode / 8, episode, episode != 2, 0.5 * episode)


def make(directory: Path, lengths: list[int], plan: Plan = PLAN) -> Path:
    """Make a run with these numbers of episodes in its trials."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("experiment_runner.store.store.time", lambda: 1_000_000_000.0)
        with open_run(directory, plan) as store:
            checkpoints = {2: Checkpoint(b"2")}
            if records := [
                (spec.id, result(trial, episode), checkpoints.get(episode), (), ())
                for trial, (spec, length) in enumerate(zip(plan.expand(), lengths, strict=True))
                for episode in range(1, length + 1)
            ]:
                store.record_all(records)
    return directory


@pytest.fixture(scope="module")
def _made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make(tmp_path_factory.mktemp("made") / "run", [4, 4, 4, 3])


@pytest.fixture
def run(_made: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(_made, tmp_path / "run"))


def call(*arguments: object) -> str:
    done = CliRunner().invoke(
        results, list(map(str, arguments)), catch_exceptions=False, standalone_mode=False
    )
    return done.stdout


# list and show


def test_list_shows_every_run_below(tmp_path: Path, run: Path) -> None:
    make(tmp_path / "deep" / "er" / "done", [4, 4, 4, 4])
    header, done, ours = call("list", tmp_path).splitlines()
    assert header.split() == ["run", "started", "trials", "episodes", "state", "reason"]
    assert done.split() == [
        str(tmp_path / "deep" / "er" / "done"),
        *("2001-09-09", "01:46", "UTC", "4/4", "16/16", "finished"),
    ]
    assert ours.split()[-3:] == ["3/4", "15/16", "interrupted"]


def test_list_and_show_tell_a_run_under_way_and_a_failure(tmp_path: Path, run: Path) -> None:
    with open_run(run, recorded_plan(run)) as store:
        assert f"running  process {os.getpid()} on" in call("list", tmp_path)
        assert f"running (process {os.getpid()} on" in call("show", run).splitlines()[0]
        store.record_failure(TRIALS[3], "the agent raised ValueError: no")
        store.record_void(TRIALS[3], 4, "the agent was lost")
    listed = call("list", tmp_path).splitlines()[1]
    assert listed.endswith(f"failed  {TRIALS[3]}: the agent raised ValueError: no")
    shown = call("show", run).splitlines()
    assert shown[0] == f"{run}: failed"
    assert f"failed: {TRIALS[3]}: the agent raised ValueError: no" in shown
    assert f"void: episode 4 of {TRIALS[3]}: the agent was lost" in shown
    assert f"rewind: {TRIALS[3]}: continues after episode 2; 1 recorded episode is run again" in shown


def test_list_goes_on_past_a_run_that_cannot_be_read(tmp_path: Path, run: Path) -> None:
    (tmp_path / "broken").mkdir()
    (tmp_path / "broken" / "results.sqlite").write_text("nothing of the kind " * 100)
    done = CliRunner().invoke(results, ["list", str(tmp_path)], standalone_mode=False)
    assert done.return_value == 1
    assert str(run) in done.stdout
    assert "broken: file is not a database" in done.stderr


def test_list_without_runs_prints_a_note(tmp_path: Path) -> None:
    done = CliRunner().invoke(results, ["list", str(tmp_path)], standalone_mode=False)
    assert (done.stdout, done.stderr) == ("", f"there are no runs in {tmp_path}\n")
    with pytest.raises(ConfigError, match="there is no folder"):
        call("list", tmp_path / "absent")


def test_show_has_a_line_for_each_setting(run: Path) -> None:
    lines = call("show", run).splitlines()
    header = next(i for i, line in enumerate(lines) if line.startswith("setting"))
    random, sarsa = (line.split() for line in lines[header + 1 : header + 3])
    # random's trials average 2.5/8 and 10 + 2.5/8, sarsa's 20 + 2.5/8 and, so far, 30 + 2/8
    assert random == ["random", "2/2", "8", "5.31", "0.31", "to", "10.31", "(!)", "5.31", "-"]
    assert sarsa == ["sarsa", "1/2", "7", "25.28", "20.31", "to", "30.25", "(!)", "25.28", "-"]


def test_show_sorts_the_settings_of_several_runs(run: Path, tmp_path: Path) -> None:
    make(tmp_path / "other", [4, 4, 4, 4], plan=replace(PLAN, seed=1))
    shown = call("show", run, tmp_path / "other", "--sort", "mean")
    lines = shown.splitlines()
    header = next(i for i, line in enumerate(lines) if line.startswith("setting"))
    assert [line.split()[:2] for line in lines[header + 1 : header + 3]] == [
        ["sarsa", "3/4"],
        ["random", "4/4"],
    ]
    assert "(!) of fewer than 5 trials" in shown
    both = json.loads(call("show", run, tmp_path / "other", "--json"))
    assert [one["run"] for one in both] == [str(run), str(tmp_path / "other")]


def test_finished_competition_is_finished_whatever_its_episodes(run: Path) -> None:
    with Store.open(run) as store:
        for trial in store.trials():
            if not trial.finished:
                store.record_outcome(trial.spec.id, TrialEnd("it left", b"digest"))
        found = overview(store)
    assert (found.trials, found.episodes) == ((4, 4), (15, 15))
    with Results.open(run) as results:
        assert overview(results).state == "finished"


# export


EXPECTED = [
    {
        "trial": TRIALS[trial],
        "episode": episode,
        "return": result(trial, episode).episode_return,
        "steps": episode,
        "terminal": episode != 2,
        "wall_time": 0.5 * episode,
        "late": 0,
        "seed": PLAN.expand()[trial].seed,
        "agent": "random" if trial < 2 else "sarsa",
        "environment": "mario",
        "environment.level_seed": 121,
        "environment.slow": False,
        **({} if trial < 2 else {"agent.step_size": 0.5, "agent.note": 'a "quote", and é'}),
    }
    for trial in range(4)
    for episode in range(1, 4 if trial == 3 else 5)
]


def test_list_and_show_as_json_are_for_scripts(run: Path, tmp_path: Path) -> None:
    with open_run(run, recorded_plan(run)) as store:
        store.record_failure(TRIALS[3], "no")
        store.record(TRIALS[3], EpisodeResult(3, math.inf, 3, True, 1.0))
    (listed,) = json.loads(call("list", tmp_path, "--json"))
    assert listed == {
        "run": str(run),
        "started": 1_000_000_000.0,
        "finished_trials": 3,
        "trials": 4,
        "episodes": 15,
        "planned_episodes": 16,
        "state": "failed",
        "reason": f"{TRIALS[3]}: no",
    }
    shown = json.loads(call("show", run, "--json"))
    assert listed.items() <= shown.items()
    assert [(s["setting"], s["finished_trials"], s["mean"]) for s in shown["settings"]] == [
        ("random", 2, 5.3125),
        ("sarsa", 1, 20.3125),  # without the failed trial
    ]
    assert shown["settings"][0]["low"] == 0.3125
    assert [t["failure"] for t in shown["trial_records"]] == [None, None, None, "no"]
    assert [event["kind"] for event in shown["events"]] == ["start", "resume", "rewind"]
    with pytest.raises(ConfigError, match="no folder"):
        call("list", tmp_path / "absent", "--json")


# remove


def test_removed_run_is_gone_with_its_directory_but_not_what_is_not_its(run: Path, tmp_path: Path) -> None:
    call("remove", make(tmp_path / "other", [0, 0, 0, 0]), "--yes")
    assert not (tmp_path / "other").exists()
    (run / "notes.txt").write_text("mine")
    done = CliRunner().invoke(results, ["remove", str(run), "--yes"])
    assert (done.exit_code, [path.name for path in run.iterdir()]) == (0, ["notes.txt"])
    assert "notes.txt" in done.stderr


def test_remove_asks_first_and_refuses_a_run_under_way(run: Path, tmp_path: Path) -> None:
    done = CliRunner().invoke(results, ["remove", str(run)], input="n\n")
    assert done.exit_code == 0
    assert f"remove {run} (4 trials, 15 episodes)?" in done.stderr
    assert f"kept {run}" in done.stderr
    store = open_run(run, recorded_plan(run))
    with store, pytest.raises(ExperimentError, match=f"in use by process {os.getpid()}"):
        call("remove", run, "--yes")
    with Results.open(run) as found:
        assert len(found.trials()) == 4
    with pytest.raises(ExperimentError, match="holds no run"):
        call("remove", tmp_path, "--yes")


def test_export_has_a_row_for_each_episode_in_each_format(run: Path, tmp_path: Path) -> None:
    text = call("export", run)
    assert text.splitlines()[0].startswith("trial,episode,return,steps,terminal,wall_time,late,seed,agent,")
    shown = {True: "true", False: "false"}
    for row, expected in zip(csv.DictReader(io.StringIO(text)), EXPECTED, strict=True):
        assert {key: cell for key, cell in row.items() if cell} == {
            key: shown[cell] if isinstance(cell, bool) else str(cell) for key, cell in expected.items()
        }
    assert json.loads(call("export", run, "--format", "json")) == EXPECTED
    call("export", run, "--format", "parquet", "--out", tmp_path / "out")
    rows = parquet.read_table(tmp_path / "out").to_pylist()
    assert [{key: cell for key, cell in row.items() if cell is not None} for row in rows] == EXPECTED
    for kind in ("csv", "json"):
        assert call("export", run, "--format", kind, "--out", tmp_path / "out") == ""
        assert (tmp_path / "out").read_text() == call("export", run, "--format", kind)


def test_export_writes_through_links_and_to_devices_without_replacing_them(run: Path, tmp_path: Path) -> None:
    (tmp_path / "link").symlink_to(tmp_path / "target")
    call("export", run, "--out", tmp_path / "link")
    assert (tmp_path / "link").is_symlink()
    assert (tmp_path / "target").read_text() == call("export", run)
    os.mkfifo(tmp_path / "pipe")
    reader = os.open(tmp_path / "pipe", os.O_RDONLY | os.O_NONBLOCK)
    nameless = os.pipe()
    for pipe, reading in ((tmp_path / "pipe", reader), (Path(f"/dev/fd/{nameless[1]}"), nameless[0])):
        call("export", run, "--out", pipe)
        assert os.read(reading, 1 << 16).decode() == call("export", run)
    for descriptor in (reader, *nameless):
        os.close(descriptor)
    assert (tmp_path / "pipe").is_fifo()


def test_export_to_a_full_disk_or_a_reader_that_left_is_one_line_or_none(run: Path) -> None:
    command = [sys.executable, "-m", "glue_rl", "results", "export", str(run)]
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(command, stdout=full, stderr=subprocess.PIPE, text=True)
    assert done.returncode != 0
    assert done.stderr.splitlines()[0] == "Error: cannot write the table: the disk is full"
    assert "Traceback" not in done.stderr
    reading, writing = os.pipe()
    os.close(reading)
    done = subprocess.run(command, stdout=writing, stderr=subprocess.PIPE, text=True)
    os.close(writing)
    assert (done.returncode, done.stderr) == (1, "")


def test_unusual_returns_and_mixed_options_are_exported(tmp_path: Path) -> None:
    sweeps = tuple(RoleSweep("r", {"x": (1, 2.5), "y": y}, f"r{y}") for y in (3, "three"))
    plan = Plan(episodes=1, agents=sweeps)
    with open_run(tmp_path / "run", plan) as store:
        for spec, value in zip(plan.expand(), [math.nan, math.inf, -math.inf, 0.1 + 0.2], strict=True):
            store.record(spec.id, EpisodeResult(1, value, 1, True, 0.0, late=math.nan))
    text = call("export", tmp_path / "run", "--format", "json")
    assert [row["return"] for row in json.loads(text)] == [None, None, None, 0.1 + 0.2]
    shown = json.loads(call("show", tmp_path / "run", "--json"), parse_constant=pytest.fail)
    assert [row["mean"] for row in shown["settings"]] == [None, None, None, 0.1 + 0.2]
    assert [row["return"] for row in csv.DictReader(io.StringIO(call("export", tmp_path / "run")))] == [
        *("nan", "inf", "-inf", "0.30000000000000004")
    ]
    call("export", tmp_path / "run", "--format", "parquet", "--out", tmp_path / "out")
    table = parquet.read_table(tmp_path / "out").to_pydict()
    assert math.isnan(table["return"][0])
    assert table["return"][1:] == [math.inf, -math.inf, 0.1 + 0.2]
    assert table["late"] == [None] * 4
    assert table["agent.x"] == [1.0, 2.5, 1.0, 2.5]
    assert table["agent.y"] == ["3", "3", "three", "three"]


def test_export_of_a_run_that_has_only_begun_is_an_empty_table(tmp_path: Path) -> None:
    run = make(tmp_path / "run", [0, 0, 0, 0])
    assert "random" in call("show", run)
    assert len(call("export", run).splitlines()) == 1
    assert json.loads(call("export", run, "--format", "json")) == []
    call("export", run, "--format", "parquet", "--out", tmp_path / "out")
    assert parquet.read_table(tmp_path / "out").num_rows == 0


def test_failed_export_gives_the_reason(run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(ConfigError, match="--out FILE"):
        call("export", run, "--format", "parquet")
    with pytest.raises(ExperimentError, match=r"cannot write .*absent/x.csv: No such file"):
        call("export", run, "--out", tmp_path / "absent" / "x.csv")
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(ExperimentError, match=r"pip install 'glue-rl\[parquet\]'"):
        call("export", run, "--format", "parquet", "--out", tmp_path / "out")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["run"]


# merge


def test_parts_of_one_plan_merge_to_a_run_of_that_plan(tmp_path: Path) -> None:
    first = make(tmp_path / "first", [4, 3, 0, 0])
    second = make(tmp_path / "second", [0, 1, 4, 3])
    call("merge", first, second, "--out", tmp_path / "both")
    with Results.open(tmp_path / "both") as both:
        assert [record.spec for record in both.trials()] == PLAN.expand()
        assert [record.done for record in both.trials()] == [4, 3, 4, 3]
        for trial, trial_id in enumerate(TRIALS):
            assert both.episodes(trial_id) == [result(trial, e) for e in range(1, 4 if trial % 2 else 5)]
            assert both.checkpoint(trial_id) == (2, Checkpoint(b"2"))
    about = json.loads((tmp_path / "both" / ABOUT_FILE).read_text())
    assert list(about["merged"]) == [str(first), str(second)]
    with open_run(tmp_path / "both", PLAN) as store:
        assert [(trial.trial_id, trial.after) for trial in remaining(store)] == [
            (TRIALS[1], 2),
            (TRIALS[3], 2),
        ]


def test_runs_of_different_plans_merge_under_their_names(tmp_path: Path) -> None:
    other = Plan(episodes=4, trials=3, seed=1, environments=PLAN.environments, agents=PLAN.agents[:1])
    make(tmp_path / "a", [4, 4, 4, 4])
    make(tmp_path / "b", [4, 2, 1], other)
    with open_run(tmp_path / "b", recorded_plan(tmp_path / "b")) as store:
        store.record_void("random/mario/0", 1, "the agent was lost")
        store.record_failure("random/mario/2", "it broke")
    call("merge", tmp_path / "a", tmp_path / "b", "--out", tmp_path / "ab")
    with Results.open(tmp_path / "ab") as merged, Results.open(tmp_path / "b") as theirs:
        assert [record.spec.id for record in merged.trials()] == [
            *("a/random/mario/0", "b/random/mario/0", "a/random/mario/1", "b/random/mario/1"),
            *("sarsa/mario/0", "sarsa/mario/1", "random/mario/2"),
        ]
        seeds: dict[str, int] = {record.spec.id: record.spec.seed for record in merged.trials()}
        assert seeds["a/random/mario/0"] == PLAN.expand()[0].seed
        assert seeds["b/random/mario/0"] == other.expand()[0].seed
        assert merged.episodes("b/random/mario/0") == theirs.episodes("random/mario/0")
        assert merged.trials()[-1].failure == "it broke"
        (void,) = merged.voids()
        assert void == theirs.voids()[0]._replace(trial_id="b/random/mario/0")
        assert [event.trial_id for event in merged.events()] == ["random/mario/2"]
    assert not (tmp_path / "ab" / PLAN_FILE).exists()
    assert "b/random" not in call("show", tmp_path / "ab").split("setting")[0]


def test_merged_run_without_a_plan_is_not_said_to_go_on(tmp_path: Path, run: Path) -> None:
    (run / "plan.toml").unlink()
    with pytest.raises(ExperimentError, match="holds a run: choose another directory with --out"):
        call("merge", run, run, "--out", run)


def test_runs_that_contradict_each_other_do_not_merge(tmp_path: Path) -> None:
    make(tmp_path / "a", [4, 4, 4, 4])
    make(tmp_path / "b", [2, 0, 0, 0])
    with open_run(tmp_path / "b", recorded_plan(tmp_path / "b")) as store:
        store.rewind(TRIALS[0], 1)
        store.record(TRIALS[0], EpisodeResult(2, 99.0, 2, True, 1.0))
    with pytest.raises(ExperimentError, match=f"episode 2 of {TRIALS[0]} differs between .*/a and .*/b"):
        call("merge", tmp_path / "a", tmp_path / "b", "--out", tmp_path / "ab")
    assert not (tmp_path / "ab").exists()


def test_merge_of_a_run_under_way_copies_no_checkpoint_without_its_episodes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def and_then_an_episode_is_recorded(read: Callable[[Results, str], Any]) -> Callable[[Results, str], Any]:
        def reading(results: Results, trial_id: str) -> Any:
            found = read(results, trial_id)
            episode = store.done(trial_id) + 1
            store.record(trial_id, result(0, episode), Checkpoint(b"%d" % episode))
            return found

        return reading

    with open_run(tmp_path / "run", PLAN) as store, monkeypatch.context() as patched:
        for name in ("episodes", "checkpoint"):
            patched.setattr(Results, name, and_then_an_episode_is_recorded(getattr(Results, name)))
        call("merge", tmp_path / "run", "--out", tmp_path / "merged")
    with Results.open(tmp_path / "merged") as merged:
        for trial_id in TRIALS:
            checkpoint = merged.checkpoint(trial_id)
            assert checkpoint is not None
            assert checkpoint[0] <= len(merged.episodes(trial_id))


def test_two_runs_of_one_name_that_would_collide_are_refused(tmp_path: Path) -> None:
    other = Plan(episodes=4, seed=1, environments=PLAN.environments, agents=PLAN.agents[:1])
    make(tmp_path / "x" / "run", [1, 1, 1, 1])
    make(tmp_path / "y" / "run", [1], other)
    with pytest.raises(ExperimentError, match="two trials would be called run/random/mario/0"):
        call("merge", tmp_path / "x" / "run", tmp_path / "y" / "run", "--out", tmp_path / "xy")


# agent


def test_agent_is_what_the_newest_checkpoint_of_the_trial_has(run: Path, tmp_path: Path) -> None:
    out = tmp_path / "some.agent"
    out.write_text("an older one, which is longer")
    done = CliRunner().invoke(results, ["agent", str(run), "--trial", TRIALS[3], "-o", str(out)])
    assert (done.exit_code, done.stdout) == (0, "")
    assert done.stderr == f"wrote {out}: the agent of {TRIALS[3]} after 2 episodes\n"
    assert out.read_bytes() == b"2"
    only = make(tmp_path / "only", [3], Plan(episodes=4, agents=PLAN.agents[:1]))
    call("agent", only, "--out", tmp_path / "only.agent")
    assert (tmp_path / "only.agent").read_bytes() == b"2"


def test_agent_that_is_not_there_is_explained(run: Path, tmp_path: Path) -> None:
    out = tmp_path / "some.agent"
    Store.create(tmp_path / "empty", [], {}).close()
    with pytest.raises(ExperimentError, match="has no trials"):
        call("agent", tmp_path / "empty", "--out", out)
    with pytest.raises(ConfigError, match=f"run has 4 trials: .* --trial {TRIALS[0]}"):
        call("agent", run, "--out", out)
    with pytest.raises(ConfigError, match=f"has no trial sarsa/mario; did you mean .*{TRIALS[2]}"):
        call("agent", run, "--trial", "sarsa/mario", "--out", out)
    with pytest.raises(ExperimentError, match=r"cannot write .*absent"):
        call("agent", run, "--trial", TRIALS[0], "--out", tmp_path / "absent" / "some.agent")
    make(tmp_path / "begun", [1, 0, 0, 0])
    with pytest.raises(ExperimentError, match=f"{TRIALS[0]} has no checkpoint yet, after 1 of 4 episodes"):
        call("agent", tmp_path / "begun", "--trial", TRIALS[0], "--out", out)
    assert not out.exists()


class Unsaved(RandomAgent):
    agent_save = None  # type: ignore[assignment]


def test_agent_that_cannot_be_saved_is_named(tmp_path: Path) -> None:
    players = ("--env", "mines", "--agent", f"{__file__}:Unsaved", "--episodes", "1")
    run = str(tmp_path / "run")
    assert CliRunner().invoke(experiment, ["--in-process", *players, "--out", run]).exit_code == 0
    with pytest.raises(ExperimentError, match="Unsaved/mines/0 has no checkpoint: its agent or"):
        call("agent", run, "--out", tmp_path / "mine.agent")


# compare


def test_table_of_a_paper_is_in_latex_or_markdown(run: Path) -> None:
    assert r"\toprule" in call("table", run, "--format", "latex")
    shown = call("table", run, "--select", "sarsa").splitlines()
    assert shown[0] == "| agent | mean return |"
    assert len(shown) == 5


def test_comparison_of_few_trials_says_so(run: Path, tmp_path: Path) -> None:
    other = make(tmp_path / "other", [4, 4, 4, 4])
    *_, last, note = call("compare", run, other).splitlines()
    assert " 1 (!) " in last  # of the two, one is not finished
    assert note == "((!) fewer than 5 trials: their intervals are too narrow)"


# glue-plot


def draw(run: Path, out: Path, *arguments: str) -> Result:
    return CliRunner().invoke(plot, [str(run), "-o", str(out), *arguments], standalone_mode=False)


@pytest.mark.parametrize("kind", ["curves", "profile"])
def test_plot_draws_each_kind(run: Path, tmp_path: Path, kind: str) -> None:
    assert draw(run, tmp_path / "out.svg", "--kind", kind).exception is None
    assert (tmp_path / "out.svg").read_text().count("<path") > 50


@pytest.mark.parametrize(
    ("wrong", "why"),
    [
        ("--select=nobody", "no setting has nobody"),
        ("--size=3", "as in 6.4x4; not 3"),
        ("--metric=epsilon", "no metric epsilon; glue-experiment records metrics with --metrics-every"),
    ],
)
def test_plot_of_what_there_is_not_is_refused(run: Path, tmp_path: Path, wrong: str, why: str) -> None:
    refused = draw(run, tmp_path / "out.svg", wrong).exception
    assert isinstance(refused, ConfigError | UsageError)  # the exit code is 2
    assert why in str(refused)


@pytest.mark.parametrize("form", ["", "--kind=scatter --out=x.svg", "--over=steps --out=x.svg"])
def test_plot_of_what_no_episode_has_is_refused(tmp_path: Path, form: str) -> None:
    with open_run(tmp_path / "run", PLAN) as store:
        store.record(TRIALS[0], result(0, 1)._replace(late=math.nan))
    command = [str(tmp_path / "run"), "--y=late", *form.split()]
    with pytest.raises(ExperimentError, match="nothing to draw: no episode has a value of late"):
        CliRunner().invoke(plot, command, standalone_mode=False, catch_exceptions=False)


def test_the_list_of_subcommands_has_the_first_sentence_of_each() -> None:
    for name, listed in results.commands.items():
        _, command, _ = results.resolve_command(Context(results), [name])
        assert command is not None
        assert listed.get_short_help_str(200) == command.get_short_help_str(200)
