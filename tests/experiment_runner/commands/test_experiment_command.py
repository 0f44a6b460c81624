from __future__ import annotations

import json
from pathlib import Path

import click
import pytest
from click.testing import CliRunner, Result

from experiment_runner.commands.experiment import experiment
from experiment_runner.plan_file import load_plan
from experiment_runner.store.results import Results
from experiment_runner.store.store import Store
from glue.errors import ConfigError, ExperimentError, HubUnreachable

PLAN = """episodes = 3
max_steps = 20
trials = 2

[environments.mines]

[agents.sarsa]
step_size = [0.1, 0.5]
"""
MINES = ("--env", "mines", "--agent", "random", "--max-steps", "9", "--in-process")


@pytest.fixture(autouse=True)
def _here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("plan.toml").write_text(PLAN)


def invoke(*arguments: str) -> Result:
    return CliRunner().invoke(experiment, arguments, standalone_mode=False)


def refused(*arguments: str) -> str:
    """Return the message of a command that fails and creates nothing."""
    result = invoke(*arguments)
    assert isinstance(result.exception, ConfigError | ExperimentError | click.ClickException), result
    assert not Path("runs").exists()
    return str(result.exception)


def test_plan_runs_and_is_kept_with_the_results() -> None:
    result = invoke("--plan", "plan.toml", "--in-process", "--out", "run")
    assert (result.exception, result.return_value) == (None, 0)
    assert load_plan(Path("run/plan.toml")) == load_plan(Path("plan.toml"))
    lines = result.stdout.splitlines()
    assert [line.split()[:2] for line in lines[1:5]] == [
        [f"sarsa/step_size={size}/mines/{number}", "3/3"] for size in (0.1, 0.5) for number in (0, 1)
    ]
    assert lines[-1].endswith(" s; results in run")


def test_counts_on_the_command_line_go_before_the_plans() -> None:
    counts = ("--episodes", "1", "--trials", "1", "--seed", "9", "--max-steps", "5")
    assert invoke("--plan", "plan.toml", *counts, "--in-process", "--out", "run").return_value == 0
    plan = load_plan(Path("run/plan.toml"))
    assert (plan.episodes, plan.trials, plan.seed, plan.max_steps) == (1, 1, 9, 5)
    assert plan.agents == load_plan(Path("plan.toml")).agents


def test_dry_run_shows_the_trials_and_makes_nothing() -> None:
    result = invoke("--plan", "plan.toml", "--trials", "1", "--dry-run")
    assert result.return_value == 0
    assert result.stdout.startswith("2 trials of 3 episodes cut off after 20 steps; seed 0\n")
    assert "sarsa/step_size=0.5/mines/0  seed " in result.stdout
    assert [path.name for path in Path.cwd().iterdir()] == ["plan.toml"]


def test_same_command_goes_on_and_a_finished_run_stays_as_it_is() -> None:
    command = (*MINES, "--episodes", "4", "--json", "--out", "run")
    first = invoke(*command).stdout.splitlines()
    again = invoke(*command).stdout.splitlines()
    assert len(first) == 5
    assert len(again) == 1
    summaries = [json.loads(lines[-1]) for lines in (first, again)]
    for summary in summaries:
        del summary["seconds"]
    assert summaries[0] == summaries[1]
    assert (summaries[0]["episodes"], summaries[0]["failed_trials"], summaries[0]["out"]) == (4, 0, "run")


def test_resume_goes_on_with_whatever_the_plan_was() -> None:
    invoke("--plan", "plan.toml", "--in-process", "--out", "run")
    assert invoke("--resume", "run", "--in-process").return_value == 0
    with Results.open(Path("run")) as results:
        assert [event.kind for event in results.events()] == ["start", "resume"]


def test_directory_without_a_name_is_made_in_runs() -> None:
    for _ in range(3):
        assert invoke(*MINES, "--episodes", "1").return_value == 0
    assert invoke("--plan", "plan.toml", "--in-process").return_value == 0
    names = sorted(path.name.split("-", 2)[2] for path in Path("runs").iterdir())
    assert names[0] == "plan"
    assert len(names) == 4
    assert all(name.startswith("random-mines") for name in names[1:])


def test_failed_trial_makes_the_exit_code_and_is_explained() -> None:
    Path("bad.py").write_text(
        "from agents.baselines import RandomAgent\n"
        "class Bad(RandomAgent):\n"
        "    def agent_start(self, observation):\n"
        "        raise ValueError('a mistake')\n"
    )
    result = invoke(
        "--env", "mines", "--agent", "bad.py:Bad", "--episodes", "2", "--in-process", "--out", "r"
    )
    assert result.return_value == 1
    assert "Bad/mines/0" in result.stdout
    # The only trial: its error is shown when it fails, and not again below the table.
    assert result.stderr.count("agent Bad raised in agent_start: ValueError: a mistake") == 1
    assert "a mistake" not in result.stdout
    assert "raise ValueError('a mistake')" in result.stderr  # their own line, in its traceback


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((), "--episodes, or a --plan, or a run to --resume"),
        (("--plan", "plan.toml", "--env", "mines"), "leave out --agent and --env"),
        (("--plan", "plan.toml", "--agent-option", "step_size=0.2"), "below [agents.NAME]"),
        ((*MINES, "--episodes", "3", "--engine", "ray", "--address", f"h:{'9' * 5000}"), "HOST:PORT"),
        (("--episodes", "3", "--env", "mines", "--bind", f"tcp://h:{'9' * 5000}"), "address of a hub"),
        (("--episodes", "3", "--env", "mines", "--legacy-port", "9" * 5000), "PORT"),
        (("--plan", "nowhere.toml"), "cannot read the plan nowhere.toml"),
        (("--resume", "nowhere"), "nowhere holds no run"),
        (("--resume", "run", "--episodes", "3"), "leave out --plan, --out"),
        (("--resume", "run", "--out", "other"), "leave out --plan, --out"),
        (("--episodes", "3", "--agent-option", "a=1"), "--agent-option needs --agent NAME"),
        (("--episodes", "3", "--in-process", "--env", "mines"), "--agent NAME is missing"),
        (("--episodes", "3", "--workers", "2", "--agent", "random"), "--env NAME is missing"),
        (
            (*MINES, "--episodes", "3", "--workers", "2", "--hub", "tcp://h:1"),
            "own hub",
        ),
        ((*MINES, "--episodes", "3", "--address", "h:1"), "--engine ray"),
        (
            ("--episodes", "3", "--hub", "tcp://h:1", "--bind", "ipc://x"),
            "--bind is for a hub that the experiment starts",
        ),
        ((*MINES, "--episodes", "3", "--legacy-port", "4096"), "with --in-process there is no hub"),
        (("--episodes", "0"), "0 is not in the range"),
    ],
)
def test_invalid_command_is_refused(arguments: tuple[str, ...], message: str) -> None:
    assert message in refused(*arguments)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--hub", "ipc:///nowhere/hub", "--wait", "0.1"), "no hub has answered"),
        (("--hub", "tcp://nowhere.invalid:4097"), "cannot find the host 'nowhere.invalid'"),
        (("--hub", "tcp://127.0.0.1:4097", "--key", "nobody", "--hub-key", "nobody"), "no file nobody"),
    ],
    ids=["silent", "unknown", "key"],
)
def test_run_whose_hub_cannot_be_joined_leaves_nothing_behind(
    arguments: tuple[str, ...], message: str
) -> None:
    result = invoke("--episodes", "3", *arguments, "--out", "run", "--record", "run/it.traj")
    assert message in str(result.exception)
    assert not Path("run").exists()
    Path("mine").mkdir()
    invoke("--episodes", "3", *arguments, "--out", "mine")
    invoke("--episodes", "3", *arguments)
    assert sorted(map(str, Path().rglob("*"))) == ["mine", "plan.toml", "runs"]


def test_run_whose_hub_is_gone_stays_as_it_is() -> None:
    assert invoke(*MINES, "--episodes", "1", "--out", "run").return_value == 0
    with Store.open(Path("run")) as store:
        store.rewind(store.trials()[0].spec.id, 0)
    with Results.open(Path("run")) as results:
        before = results.trials()
    result = invoke("--resume", "run", "--hub", "ipc:///nowhere/hub", "--wait", "0.1")
    assert isinstance(result.exception, HubUnreachable)
    assert "nothing is lost: continue with --resume run" in result.stderr
    with Results.open(Path("run")) as results:
        assert results.trials() == before


@pytest.mark.parametrize(
    ("plan", "message"),
    [
        (
            "episodes = 3\ntrials =\nseed = 1",
            "plan.toml: this is not TOML: Invalid value (at line 2, column 9)",
        ),
        ("episodes = 0", "plan.toml: episodes must be a whole number from 1"),
        ("episodes = 1\n[agents.sarsa]\nstep_size = [0.1, 7]", "sarsa: option step_size must be from 0 to 1"),
        ("episodes = 1\n[agents.sarsa]\nstep_size = [0.5, 0.5]", "sarsa/step_size=0.5/remote/0 twice"),
    ],
)
def test_mistake_in_a_plan_is_one_of_the_command(plan: str, message: str) -> None:
    Path("plan.toml").write_text(plan)
    result = invoke("--plan", "plan.toml")
    assert isinstance(result.exception, ConfigError)  # which makes the exit code 2
    assert message in str(result.exception)
    assert not Path("runs").exists()


LAZY = """from agents.baselines import RandomAgent
class Lazy(RandomAgent):
    pass
"""


def test_class_in_a_file_is_found_from_another_directory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    Path("exp").mkdir()
    Path("exp/lazy.py").write_text(LAZY)
    Path("exp/plan.toml").write_text(
        'episodes = 2\n[environments.mines]\n[agents.mine]\nclass = "lazy.py:Lazy"\n'
    )
    assert (
        invoke("--plan", "exp/plan.toml", "--in-process", "--max-steps", "9", "--out", "run").return_value
        == 0
    )
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    result = invoke("--resume", "../run", "--in-process", "--trust")
    assert (result.exception, result.return_value) == (None, 0)


def test_resume_runs_code_that_the_run_names_only_if_it_is_trusted() -> None:
    Path("lazy.py").write_text(LAZY)
    command = ("--env", "mines", "--agent", "lazy.py:Lazy", "--max-steps", "9", "--episodes", "2")
    assert invoke(*command, "--in-process", "--out", "run").return_value == 0
    Path("lazy.py").write_text("raise SystemExit('this was run')")
    result = invoke("--resume", "run", "--in-process")
    assert isinstance(result.exception, ConfigError)
    assert str(Path("lazy.py").absolute()) in str(result.exception)
    assert "--trust" in str(result.exception)


def test_finished_trial_that_an_earlier_version_left_as_failed_is_mended_by_resume() -> None:
    assert invoke(*MINES, "--episodes", "2", "--out", "run").return_value == 0
    with Store.open(Path("run")) as store:
        store.record_failure("random/mines/0", "agent RandomAgent raised in agent_cleanup")
    assert invoke("--resume", "run", "--in-process").return_value == 0


def test_resume_reports_what_is_repeated() -> None:
    assert invoke(*MINES, "--episodes", "6", "--checkpoint-every", "2", "--out", "run").return_value == 0
    with Store.open(Path("run")) as store:
        found = store.checkpoint("random/mines/0")
        assert found is not None
        episodes = store.episodes("random/mines/0")
        store.rewind("random/mines/0", 3)
        store.record("random/mines/0", episodes[3], found[1])
        store.record("random/mines/0", episodes[4])
    result = invoke("--resume", "run", "--in-process")
    assert "random/mines/0 continues after episode 4; 1 recorded episode is run again" in result.stderr


def test_empty_file_of_a_recording_that_failed_is_replaced_and_nothing_else_is() -> None:
    Path("empty.traj").touch()
    Path("mine.traj").write_text("mine")
    command = (*MINES, "--episodes", "1", "--record")
    assert invoke(*command, "empty.traj").return_value == 0
    assert Path("empty.traj").stat().st_size > 0
    assert "exists already" in str(invoke(*command, "mine.traj").exception)
    assert Path("mine.traj").read_text() == "mine"
