"""The programs in docs/examples play against ours and with each other."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final

import pytest

from glue import Action, Environment, Observation, connect
from glue.conform.clients.judge import judge
from glue.conform.clients.process import ClientProcess
from glue.conform.report import line
from glue.conform.rules import Outcome, Tier
from glue.hub.config import HubConfig
from glue.hub.io.server import Hub
from glue.wire.messages import Role
from tests.cc import compiled
from tests.hubs import serving

EXAMPLES: Final = Path(__file__).parents[2] / "docs/examples"

Program = list[str]
"""A command, which takes a hub and a session."""


def python(name: str) -> Program:
    return [sys.executable, str(EXAMPLES / f"python/{name}.py")]


@pytest.fixture(params=["python", pytest.param("c", marks=pytest.mark.stage("conformance"))])
def agent(request: pytest.FixtureRequest, tmp_path: Path) -> Program:
    return python("agent") if request.param == "python" else [str(compiled(EXAMPLES / "c/agent.c", tmp_path))]


class Wordy(Environment):
    """Shows ints, doubles and chars; ends with the third step."""

    def __init__(self) -> None:
        self.actions: list[Action] = []

    def env_init(self) -> str:
        return "no task spec"

    def env_start(self) -> Observation:
        self.actions = []
        return Observation(ints=[-7, 2**31 - 1], doubles=[1e300, -0.5], chars=b"\x00\xff")

    def env_step(self, action: Action) -> tuple[float, Observation, bool]:
        self.actions.append(action)
        below = Observation(ints=[-8], doubles=[0.25, -2.0, 4.0], chars=b"abc" * 100)
        return -0.5, below, len(self.actions) == 3

    def env_message(self, message: str) -> str:
        return message


@contextmanager
def running(command: Program) -> Iterator[subprocess.Popen[str]]:
    """Run a program; it must have ended on its own, without errors, at the end of the `with`."""
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        try:
            yield process
            _, complaint = process.communicate(timeout=60)
        finally:
            process.kill()
        assert (process.returncode, complaint) == (0, "")


def test_agent_reads_all_three_runs_and_the_rewards(agent: Program) -> None:
    hub, environment = Hub(HubConfig(bind=("tcp://127.0.0.1:*",))), Wordy()
    url = hub.endpoints[0]
    with running([*agent, url]), serving(url, environment), hub.in_background(), connect(url) as glue:
        glue.rl_init()
        assert glue.rl_agent_message("") == (
            "0 episodes, 0 in all; last seen: 0 ints, 0 doubles that sum to 0, 0 chars"
        )
        assert glue.rl_episode() is True
        said = glue.rl_agent_message("größer")

    assert said == "1 episodes, -1.5 in all; last seen: 1 ints, 3 doubles that sum to 2.25, 300 chars"
    assert environment.actions == [Action([1]), Action([0]), Action([0])]


def survives(role: Role, program: Program) -> None:
    """Judge a program by all rules of the kit about faults and repetitions."""
    verdicts = judge(
        role, lambda *place: ClientProcess([*program, *place], {}), tier=Tier.SURVIVES, wait=60, quiet=0.05
    )
    assert [line(verdict) for verdict in verdicts if verdict.outcome is Outcome.FAILED] == []


@pytest.mark.stage("conformance")
def test_agent_survives(agent: Program) -> None:
    survives(Role.AGENT, agent)


@pytest.mark.stage("conformance")
def test_environment_survives() -> None:
    survives(Role.ENVIRONMENT, python("environment"))


def test_environment_agent_and_experiment_that_know_only_the_document_play_together() -> None:
    hub = Hub(HubConfig(bind=("tcp://127.0.0.1:*",)))
    url = hub.endpoints[0]
    experiment = [*python("experiment"), url, "foreign"]
    with (
        running([*python("environment"), url, "foreign"]),
        running([*python("agent"), url, "foreign"]),
        hub.in_background(),
    ):
        done = subprocess.run(experiment, capture_output=True, text=True, timeout=60)

    assert done.returncode == 0, done.stderr
    task_spec, *episodes, said = done.stdout.splitlines()
    assert task_spec.startswith("VERSION RL-Glue-3.0")
    assert episodes == [f"episode {n}: return 1, 10 steps, ended" for n in (1, 2, 3)]
    assert said.startswith("3 episodes, 3 in all")
