"""`glue-experiment` with several trials: the same results in any arrangement of processes, and failures."""

from __future__ import annotations

import json
import shutil
import signal
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path

import pytest

from experiment_runner.store.results import Results
from tests.system.runs import SLOW_AGENT, Contents, alive, children, contents, run, wait_until
from tests.terminal import Terminal

FAULTY = '''
import os
import signal
from pathlib import Path

from agents.tabular import SarsaAgent


class Faulty(SarsaAgent):
    """Does something bad in its 7th episode: always, or only if `once` cannot be made."""

    def __init__(self, *, how: str = "", once: str = "") -> None:
        super().__init__()
        self.how, self.once, self.episodes = how, once, 0

    def agent_start(self, observation):
        self.episodes += 1
        if self.episodes == 7:
            self.misbehave()
        return super().agent_start(observation)

    def misbehave(self):
        if self.once:
            try:
                Path(self.once).touch(exist_ok=False)
            except FileExistsError:
                return
        if self.how == "raise":
            raise ValueError("a mistake")
        if self.how == "exit":
            raise SystemExit(3)
        if self.how:
            os.kill(os.getpid(), getattr(signal, self.how))


class Mortal(Faulty):
    """Does it once in each episode."""

    def agent_start(self, observation):
        self.episodes += 1
        if self.once:
            self.once = f"{self.once.split('.')[0]}.{self.episodes}"
            self.misbehave()
        return SarsaAgent.agent_start(self, observation)


class Forgetful(Faulty):
    """Cannot be saved."""

    agent_save = agent_load = None
'''

MINES = ("--env", "mines", "--env-option", "random_start=true", "--max-steps", 30, "--seed", 3)
SARSA = (*MINES, "--agent", "sarsa")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "faulty.py").write_text(FAULTY)
    return tmp_path


def failures(directory: Path) -> dict[str, str | None]:
    with Results.open(directory) as results:
        return {trial.spec.id: trial.failure for trial in results.trials()}


def test_results_do_not_depend_on_the_processes(tmp_path: Path) -> None:
    plan = (*SARSA, "--episodes", 10, "--trials", 2)
    for how, name in (
        (("--in-process",), "one"),
        ((), "three"),
        (("--inside", "env"), "two"),
        (("--inside", "env", "--inside", "agent"), "one with a hub"),
        (("--in-process", "--workers", 2), "workers"),
        (("--workers", 2), "workers with players of their own"),
    ):
        done = run(*plan, *how, "--out", name, cwd=tmp_path)
        assert done.returncode == 0, done.stderr
        assert contents(tmp_path / name) == contents(tmp_path / "one")
    episodes, checkpoint = contents(tmp_path / "one")["sarsa/mines/1"]
    assert [episode[0] for episode in episodes] == list(range(1, 11))
    assert checkpoint is not None


CRASHES = {
    "raise": "agent Faulty raised in agent_start: ValueError: a mistake",
    "exit": "SystemExit: 3",
    "SIGKILL": "its worker was killed by signal 9, 3 times without progress",
}


def test_trial_that_crashes_is_recorded_and_the_rest_continue(folder: Path) -> None:
    agents = [
        f'[agents.{how or "good"}]\nclass = "faulty.py:Faulty"\nhow = "{how}"' for how in ("", *CRASHES)
    ]
    plan = ["episodes = 10", "[environments.mines]", *agents, '[agents.best]\nclass = "sarsa"']
    (folder / "plan.toml").write_text("\n".join(plan))
    done = run("--plan", "plan.toml", "--in-process", "--workers", 2, "--out", "run", cwd=folder)
    assert done.returncode == 1, done.stderr
    expected: dict[str, str | None] = {f"{how}/mines/0": why for how, why in CRASHES.items()}
    for trial, why in expected.items():
        assert f"failed: {trial}: {why}" in done.stdout
        assert f"{trial}: Error: {why}" in done.stderr
    assert failures(folder / "run") == {"good/mines/0": None, **expected, "best/mines/0": None}
    done_of = {name: len(of[0]) for name, of in contents(folder / "run").items()}
    assert done_of == {"good/mines/0": 10, **dict.fromkeys(expected, 6), "best/mines/0": 10}


@pytest.mark.parametrize("agent", ["Faulty", "Forgetful"])
def test_lost_worker_is_replaced_without_a_trace_in_the_results(folder: Path, agent: str) -> None:
    plan = (*MINES, "--agent", f"faulty.py:{agent}", "--episodes", 12, "--in-process")
    assert run(*plan, "--out", "undisturbed", cwd=folder).returncode == 0
    options = ("--agent-option", "how=SIGKILL", "--agent-option", "once=mark")
    (folder / "run").mkdir()
    done = run(
        *(*plan, *options, "--workers", 1, "--checkpoint-every", 4, "--json", "--out", "run"), cwd=folder
    )
    assert done.returncode == 0, done.stderr
    assert contents(folder / "run") == contents(folder / "undisturbed")
    trial = f"{agent}/mines/0"
    with Results.open(folder / "run") as results:
        happened = [(event.kind, event.trial_id, event.text) for event in results.events()]
    assert ("lost", trial, "its worker was killed by signal 9") in happened
    where = "continues after episode 4; 2" if agent == "Faulty" else "starts over; 6"
    assert ("rewind", trial, f"{where} recorded episodes are run again") in happened
    unsaved = [text for kind, _, text in happened if kind == "unsaved"]
    assert len(unsaved) == (2 if agent == "Forgetful" else 0)
    for text in unsaved:
        assert "no agent_save" in text
        assert "starts over" in text
    lines = [json.loads(line) for line in done.stdout.splitlines()]
    assert {line["trial"] for line in lines[:-1]} == {trial}
    assert lines[-1]["summary"]
    assert (lines[-1]["episodes"], lines[-1]["failed_trials"]) == (12, 0)


def test_player_that_is_killed_at_one_point_again_and_again_is_given_up(folder: Path) -> None:
    plan = (*MINES, "--agent", "faulty.py:Faulty", "--episodes", 12)
    done = run(*plan, "--agent-option", "how=SIGKILL", "--out", "run", cwd=folder)
    why = "the agent Faulty was killed by signal 9, 3 times without getting past episode 6"
    assert done.returncode == 1, done.stderr
    assert failures(folder / "run") == {"Faulty/mines/0": why}


def test_player_that_is_killed_at_one_point_after_another_continues(folder: Path) -> None:
    plan = (*MINES, "--agent", "faulty.py:Mortal", "--episodes", 3)
    assert run(*plan, "--in-process", "--out", "undisturbed", cwd=folder).returncode == 0
    options = ("--agent-option", "how=SIGKILL", "--agent-option", "once=mark")
    done = run(*plan, *options, "--out", "run", cwd=folder)
    assert done.returncode == 0, done.stderr
    assert contents(folder / "run") == contents(folder / "undisturbed")
    with Results.open(folder / "run") as results:
        assert [void.episode for void in results.voids()] == [1, 2, 3]


@contextmanager
def running(*arguments: object, cwd: Path) -> Iterator[Terminal]:
    """Yield a run that has finished its first episode."""
    command = ("glue-experiment", *map(str, arguments), "--json", "--out", "run")
    with closing(Terminal(*command, cwd=cwd)) as terminal:
        terminal.wait_for('"episode"')
        yield terminal


INTERRUPTED = (
    *(*MINES, "--agent", "slow.py:Slow", "--episodes", 40, "--trials", 2),
    *("--agent-option", "while_there=there", "--agent-option", "pause=0.5"),
)


@pytest.fixture
def slowed(tmp_path: Path) -> Path:
    """Return a folder in which that run lasts for at least 20 seconds."""
    shutil.copy(SLOW_AGENT, tmp_path)
    (tmp_path / "there").touch()
    return tmp_path


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> Contents:
    """Return the results of the run that is interrupted below, without interruptions."""
    folder = tmp_path_factory.mktemp("undisturbed")
    shutil.copy(SLOW_AGENT, folder)
    assert run(*INTERRUPTED, "--in-process", "--out", "run", cwd=folder).returncode == 0
    return contents(folder / "run")


@pytest.mark.parametrize(
    ("number", "code", "how"),
    [
        (signal.SIGINT, 130, ()),
        (signal.SIGINT, 130, ("--in-process",)),
        (signal.SIGTERM, 143, ("--workers", 2)),
    ],
)
def test_interrupted_run_leaves_no_process_and_continues(
    slowed: Path, how: tuple[object, ...], number: signal.Signals, code: int, undisturbed: Contents
) -> None:
    with running(*INTERRUPTED, *how, "--checkpoint-every", 1000, cwd=slowed) as terminal:
        processes = children(terminal.process.pid)
        terminal.send_signal(number)  # players and workers have process groups of their own
        assert terminal.end() == code, terminal.lines
        errors = "\n".join(terminal.lines)
    assert "continue with: glue-experiment --resume run" in errors
    assert errors.count("interrupted") == 1, errors
    assert "Traceback" not in errors
    assert not any(map(alive, processes))
    (slowed / "there").unlink()
    assert run("--resume", "run", "--in-process", "--trust", cwd=slowed).returncode == 0
    assert contents(slowed / "run") == undisturbed


def test_players_do_not_outlive_a_killed_experiment(tmp_path: Path) -> None:
    with running(*SARSA, "--episodes", 100_000, cwd=tmp_path) as terminal:
        players = children(terminal.process.pid)
        assert len(players) == 2
        terminal.send_signal(signal.SIGKILL)
        terminal.end()
    wait_until(lambda: not any(map(alive, players)), "the end of the players")
