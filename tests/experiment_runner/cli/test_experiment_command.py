from __future__ import annotations

import json
import os
import random
import re
import subprocess
from pathlib import Path
from threading import Thread

import click
import numpy as np
import pytest
from click.testing import CliRunner, Result

from agents.baselines import SkeletonAgent
from experiment_runner.cli.experiment import experiment
from experiment_runner.cli.make_plan import own_directory
from experiment_runner.plan.file import load_plan
from experiment_runner.report.overview import as_text
from experiment_runner.store.results import Results
from experiment_runner.store.store import Store
from glue import Action, Environment, Observation, Step, serve_agent
from glue.errors import ConfigError, ExperimentError, HubUnreachable
from glue.taskspec.spaces import Discrete, task_spec
from tests import forked
from tests.system.runs import contents

PLAN = """episodes = 3
max_steps = 20
trials = 2

[environments.mines]

[agents.sarsa]
step_size = [0.1, 0.5]
"""
STOPPING = """from agents.baselines import RandomAgent

class Mine(RandomAgent):
    def agent_step(self, reward, observation):
        breakpoint()
"""
PLAYERS = ("--env", "mines", "--agent", "random", "--max-steps", "9")
MINES = (*PLAYERS, "--in-process")


@pytest.fixture(autouse=True)
def _here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("plan.toml").write_text(PLAN)


def invoke(*arguments: str) -> Result:
    return CliRunner().invoke(experiment, arguments, standalone_mode=False)


def invoke_anew(*arguments: str) -> subprocess.CompletedProcess[str]:
    """Run the command in a process that has not imported another class of the same name."""
    return forked.run("glue-experiment", *arguments, cwd=Path.cwd())


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


def test_finished_run_says_so_and_is_extended_or_replaced() -> None:
    run = ("--episodes", "2", *MINES, "--out", "run")
    first, again = invoke(*run, "--json"), invoke(*run, "--json")
    assert "already finished" not in first.stderr
    assert again.return_value == 0
    assert "run was already finished on 2" in again.stderr
    assert "nothing was run" in again.stderr
    *_, summary = map(json.loads, first.stdout.splitlines())
    assert (summary["episodes"], summary["failed_trials"], summary["out"]) == (2, 0, "run")
    assert json.loads(again.stdout) == {**summary, "seconds": json.loads(again.stdout)["seconds"]}
    before = contents(Path("run"))
    assert "episodes is 3, not 2" in invoke("--resume", "run", "--episodes", "3", "--in-process").stderr
    extended = contents(Path("run"))
    assert extended["random/mines/0"][0][:2] == before["random/mines/0"][0]
    assert len(extended["random/mines/0"][0]) == 3
    assert invoke(*run, "--again").return_value == 0
    assert contents(Path("run")) == before
    Path("run/mine.txt").write_text("not the run's")
    assert isinstance(invoke(*run, "--again").exception, ExperimentError)
    assert contents(Path("run")) == before


def test_run_begun_with_an_older_version_of_a_file_is_not_continued() -> None:
    Path("constants.py").write_text("SPEED = 1")
    Path("mine.py").write_text("import constants\nfrom agents.baselines import RandomAgent as Mine")
    few = ("--episodes", "1", "--max-steps", "9", "--in-process")
    run = ("--env", "mines", "--agent", "mine.py:Mine", *few, "--out", "run")
    assert invoke_anew(*run).returncode == 0
    Path("constants.py").write_text("SPEED = 2")
    refused = invoke_anew(*run)
    assert refused.returncode == 1
    assert f"{Path('constants.py').absolute()} has changed since" in refused.stderr
    assert "--again" in refused.stderr


def test_help_fits_on_a_screen_and_all_options_are_in_its_longer_form() -> None:
    runner = CliRunner(env={"COLUMNS": "80"})
    common = runner.invoke(experiment, ["--help"]).output
    everything = runner.invoke(experiment, ["--help-all"]).output
    assert len(common.splitlines()) <= 40
    flags = {option.opts[-1] for option in experiment.params}
    assert flags == {line.split()[0] for line in everything.splitlines() if line.startswith("  --")} - {
        "--help"
    }
    assert {"--env", "--episodes", "--plan"} <= {word for word in common.split() if word in flags}


def test_breakpoint_in_a_process_of_its_own_says_where_it_works() -> None:
    Path("mine.py").write_text(STOPPING)
    run = ("--env", "mines", "--agent", "mine.py:Mine", "--episodes", "1", "--max-steps", "9")
    shown = invoke_anew(*run)
    assert shown.returncode == 1
    assert "--in-process" in shown.stderr


class Maze(Environment):
    """Draws from both global generators, and takes no seed."""

    def env_init(self) -> str:
        return task_spec(Discrete(10), Discrete(4), rewards=(-1, 0))

    def env_start(self) -> Observation:
        return Observation([random.randrange(10)])

    def env_step(self, action: Action) -> Step:
        return Step(-1.0, self.env_start(), bool(np.random.random() < 0.1))


def test_player_that_takes_no_seed_is_repeatable_from_the_global_generators_and_named_once() -> None:
    run = ("--env", f"{__file__}:Maze", "--agent", "random", "--episodes", "3", "--max-steps", "50")
    ways = {"inside": ("--in-process",), "again": ("--in-process",), "beside the hub": ("--inside", "env")}
    episodes = {}
    for name, way in ways.items():
        shown = invoke_anew(*run, *way, "--out", name)
        assert shown.returncode == 0, shown.stderr
        assert shown.stderr.count("the environment Maze has no env_seed") == 1
        assert "the agent random has no" not in shown.stderr
        with Results.open(Path(name)) as results:
            episodes[name] = results.measure("random/Maze/0", "steps").tolist()
            assert as_text([results]).count("the environment Maze has no env_seed") == 1
    assert all(steps == episodes["inside"] for steps in episodes.values())
    assert len(set(episodes["inside"])) > 1


def test_player_from_outside_that_takes_no_seed_is_named_once() -> None:
    class Chance(SkeletonAgent):
        agent_seed = None  # type: ignore[assignment]

    hub = f"ipc://{Path('hub').absolute()}"
    outside = Thread(target=serve_agent, args=(Chance(), hub))
    outside.start()
    run = ("--env", "skeleton", "--episodes", "2", "--max-steps", "9", "--bind", hub, "--out", "run")
    result = invoke(*run)
    outside.join()
    assert result.return_value == 0, result.output
    named = re.findall("the agent Chance.* takes no seed", result.stderr)
    assert len(named) == 1
    with Results.open(Path("run")) as results:
        assert as_text([results]).count(named[0]) == 1


@pytest.mark.parametrize(
    "text",
    [b'{"files": NaN}', b"[]", b"[" * 200_000, b"\xff", b'{"files": %s}' % (b"9" * 5000), b'{"merged": 3}'],
)
def test_run_whose_provenance_is_hostile_is_resumed_or_refused_in_one_line(text: bytes) -> None:
    folder = os.fsdecode(b"not-utf-8-\xff")
    invoke("--episodes", "1", *MINES, "--out", folder)
    Path(folder, "run.json").write_bytes(text)
    result = invoke("--resume", folder, "--in-process")
    assert isinstance(result.exception, ExperimentError | None), result.exception
    assert "\n" not in str(result.exception)


def test_dry_run_shows_the_trials_and_makes_nothing_and_counts_go_before_the_plans() -> None:
    counts = ("--episodes", "1", "--trials", "1", "--seed", "9", "--max-steps", "5")
    result = invoke("--plan", "plan.toml", *counts, "--dry-run")
    assert result.return_value == 0
    assert result.stdout.startswith("2 trials of 1 episodes cut off after 5 steps; seed 9\n")
    assert "sarsa/step_size=0.5/mines/0  seed " in result.stdout
    assert [path.name for path in Path.cwd().iterdir()] == ["plan.toml"]


LOUD = """import os

from agents.baselines import RandomAgent

print("imported")

class Loud(RandomAgent):
    def agent_start(self, observation):
        print("a new episode")
        os.write(1, b"raw")
        return super().agent_start(observation)
"""


@pytest.mark.parametrize("way", [("--in-process",), ("--workers", "1")])
def test_json_stands_alone_on_standard_output_whatever_players_print(way: tuple[str, ...]) -> None:
    Path("loud.py").write_text(LOUD)
    run = ("--env", "mines", "--agent", "loud.py:Loud", "--episodes", "2", "--max-steps", "9", "--json")
    shown = invoke_anew(*run, *way)
    assert shown.returncode == 0
    assert [len(json.loads(line)) for line in shown.stdout.splitlines()][:2] == [5, 5]
    assert "a new episode" in shown.stderr


def test_runs_that_begin_in_one_second_have_directories_of_their_own() -> None:
    with own_directory(None, "mine") as first, own_directory(None, "mine") as second:
        assert first != second
        assert first.is_dir()
        assert first.name.split("-", 2)[2] == "mine"
        (second / "something").touch()
    assert list(Path("runs").iterdir()) == [second]
    with own_directory(Path("given"), "mine") as given:
        assert (given, given.exists()) == (Path("given"), False)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((), "--episodes or --steps, or a --plan, or a run to --resume"),
        (("--plan", "plan.toml", "--env", "mines"), "leave out --agent and --env"),
        ((*PLAYERS, "--episodes", "1", "--rate", "24", "--hub", "tcp://127.0.0.1:9"), "glue-hub"),
        ((*PLAYERS, "--episodes", "1", "--rate", "24", "--inside", "agent"), "leave out --inside agent"),
        ((*MINES, "--episodes", "1", "--late", "1"), "give a rate or a delay, too"),
        ((*MINES, "--episodes", "1", "--delay", "1", "--check-actions"), "leave out --check-actions"),
        (("--plan", "plan.toml", "--agent-option", "step_size=0.2"), "below [agents.NAME]"),
        ((*MINES, "--episodes", "3", "--engine", "ray", "--address", f"h:{'9' * 5000}"), "HOST:PORT"),
        (("--episodes", "3", "--env", "mines", "--bind", f"tcp://h:{'9' * 5000}"), "address of a hub"),
        (("--episodes", "3", "--env", "mines", "--legacy-port", "9" * 5000), "PORT"),
        (("--plan", "nowhere.toml"), "cannot read the plan nowhere.toml"),
        (("--resume", "nowhere"), "nowhere holds no run"),
        (("--resume", "run", "--out", "other"), "leave out --plan, --out"),
        (("--resume", "run", "--seed", "3"), "leave out --plan, --out"),
        (("--episodes", "3", "--agent-option", "a=1"), "--agent-option needs --agent NAME"),
        (("--episodes", "3", "--in-process", "--env", "mines"), "--agent NAME is missing"),
        (("--episodes", "3", "--workers", "2", "--agent", "random"), "--env NAME is missing"),
        ((*PLAYERS, "--episodes", "3", "--workers", "2", "--session", "a"), "its own hub"),
        ((*PLAYERS, "--episodes", "3", "--engine", "ray", "--hub", "tcp://h:1"), "its own hub"),
        ((*PLAYERS, "--agent", "sarsa"), "random and sarsa (--plan)"),
        ((*MINES, "--episodes", "3", "--address", "h:1"), "--engine ray"),
        (
            ("--episodes", "3", "--hub", "tcp://h:1", "--bind", "ipc://x"),
            "--bind is for a hub that the experiment starts",
        ),
        ((*MINES, "--episodes", "3", "--legacy-port", "4096"), "with --in-process there is no hub"),
        ((*PLAYERS, "--episodes", "3", "--inside", "env", "--hub", "tcp://h:1"), "leave out --hub"),
        (("--agent", "random", "--episodes", "3", "--inside", "env"), "--env NAME is missing"),
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
    assert sorted(map(str, Path().rglob("*"))) == ["mine", "plan.toml"]


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
    done = invoke("--plan", "exp/plan.toml", "--in-process", "--max-steps", "9", "--out", "run")
    assert done.return_value == 0
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    result = invoke("--resume", "../run", "--in-process", "--trust")
    assert (result.exception, result.return_value) == (None, 0)


@pytest.mark.parametrize("name", ["lazy.py:Lazy", "idle:Lazy"])
def test_resume_runs_code_that_the_run_names_only_if_it_is_trusted(name: str) -> None:
    file = Path(name.partition(":")[0]).with_suffix(".py")
    file.write_text(LAZY)
    command = ("--env", "mines", "--agent", name, "--max-steps", "9", "--episodes", "2")
    assert invoke(*command, "--in-process", "--out", "run").return_value == 0
    file.write_text("raise SystemExit('this was run')")
    result = invoke("--resume", "run", "--in-process")
    assert isinstance(result.exception, ConfigError)
    shown = str(file.absolute()) if name.startswith("lazy") else name
    assert f"run would run or ask {shown}: if you trust it, add --trust" in str(result.exception)


def test_finished_trial_that_an_earlier_version_left_as_failed_is_mended_by_resume() -> None:
    assert invoke(*MINES, "--episodes", "2", "--out", "run").return_value == 0
    with Store.open(Path("run")) as store:
        store.record_failure("random/mines/0", "agent RandomAgent raised in agent_cleanup")
    assert invoke("--resume", "run", "--in-process").return_value == 0


def test_empty_file_of_a_recording_that_failed_is_replaced() -> None:
    Path("empty.traj").touch()
    assert invoke(*MINES, "--episodes", "1", "--record", "empty.traj").return_value == 0
    assert Path("empty.traj").stat().st_size > 0


def test_a_run_whose_directory_was_removed_meanwhile_does_not_end_as_a_success() -> None:
    Path("removing.py").write_text(
        "import shutil\nfrom agents.baselines import RandomAgent\n\nclass Removing(RandomAgent):\n"
        "    def agent_cleanup(self):\n        shutil.rmtree('run')\n"
    )
    command = ("--env", "mines", "--agent", "removing.py:Removing", "--episodes", "1", "--max-steps", "9")
    with pytest.raises(ExperimentError, match="run was moved or removed during the run"):
        raise invoke(*command, "--in-process", "--out", "run").exception or AssertionError
