"""The programs in docs/examples and our clients in other languages play against ours and with each other."""

from __future__ import annotations

import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final

import pytest

from env_server.toys import SkeletonEnvironment
from glue.client.experiment import connect
from glue.engine.experiment import Experiment
from glue.hub.config import HubConfig
from glue.hub.io.server import Hub
from glue.roles import Environment
from glue.types import Action, Observation
from tests.cc import compiled
from tests.hubs import serving
from tests.system.proxy import WelcomeThief

EXAMPLES: Final = Path(__file__).parents[2] / "docs/examples"
PYTHON: Final = EXAMPLES / "python"
JAVASCRIPT: Final = Path(__file__).parents[1] / "clients/walker.mjs"

Agent = Callable[[str], list[str]]
"""The command that starts an agent at a hub."""


def python_agent(hub: str) -> list[str]:
    return [sys.executable, str(PYTHON / "agent.py"), hub]


def javascript_agent(hub: str) -> list[str]:
    node = shutil.which("node")
    if node is None:
        pytest.skip("there is no node here to run the JavaScript agent")
    return [node, str(JAVASCRIPT), hub]


@pytest.fixture(scope="module")
def c_agent(tmp_path_factory: pytest.TempPathFactory) -> Agent:
    program = compiled(EXAMPLES / "c/agent.c", tmp_path_factory.mktemp("c"))
    return lambda hub: [str(program), hub]


@pytest.fixture(params=["python", "javascript", "c"])
def agent(request: pytest.FixtureRequest) -> Agent:
    if request.param == "c":
        compiled: Agent = request.getfixturevalue("c_agent")
        return compiled
    return {"python": python_agent, "javascript": javascript_agent}[request.param]


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
def running(command: list[str]) -> Iterator[subprocess.Popen[str]]:
    """Run a program; it must have ended on its own, without errors, at the end of the `with`."""
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        try:
            yield process
            _, complaint = process.communicate(timeout=60)
        finally:
            process.kill()
        assert (process.returncode, complaint) == (0, "")


@contextmanager
def table_for(
    agent: Agent, environment: Environment, through: Callable[[str], str] = str
) -> Iterator[Experiment]:
    """Connect a foreign agent, our environment and an experiment to a hub of ours.

    `through` may put something between the agent and the hub: it maps the hub's URL to another.
    """
    hub = Hub(HubConfig(bind=("tcp://127.0.0.1:*",)))
    url = hub.endpoints[0]
    with (
        running(agent(through(url))),
        serving(url, environment),
        hub.in_background(),
        connect(url) as glue,
    ):
        yield glue


def test_agent_walks_the_skeleton_environment(agent: Agent) -> None:
    with table_for(agent, SkeletonEnvironment()) as glue:
        assert glue.rl_init(seed=1).startswith("VERSION RL-Glue-3.0")
        assert [glue.rl_episode(max_steps) for max_steps in (0, 100, 5)] == [True, True, False]
        assert (glue.rl_num_episodes(), glue.rl_num_steps(), glue.rl_return()) == (2, 5, 0.0)
        said = glue.rl_agent_message("how was it?")
        glue.rl_cleanup()

    assert said == "2 episodes, 2 in all; last seen: 1 ints, 0 doubles that sum to 0, 0 chars"


def test_agent_reads_all_three_runs_and_the_rewards(agent: Agent) -> None:
    environment = Wordy()
    with table_for(agent, environment) as glue:
        glue.rl_init()
        assert glue.rl_agent_message("") == (
            "0 episodes, 0 in all; last seen: 0 ints, 0 doubles that sum to 0, 0 chars"
        )
        assert glue.rl_episode() is True
        said = glue.rl_agent_message("größer")

    assert said == "1 episodes, -1.5 in all; last seen: 1 ints, 3 doubles that sum to 2.25, 300 chars"
    assert environment.actions == [Action([1]), Action([0]), Action([0])]


def test_agent_survives_a_connection_that_is_cut_again_and_again(agent: Agent) -> None:
    with WelcomeThief() as proxy, table_for(agent, SkeletonEnvironment(), proxy.before) as glue:
        glue.rl_init()
        returns = []
        for _ in range(3):
            start = glue.rl_start()
            proxy.cut()
            states = [int(start.observation.ints[0])]
            while not (step := glue.rl_step()).terminal:
                states.append(int(step.observation.ints[0]))
                if step.observation.ints[0] == 15:
                    proxy.cut()
            assert states == list(range(10, 20))
            returns.append(glue.rl_return())
        said = glue.rl_agent_message("did you notice?")

    assert returns == [1.0, 1.0, 1.0]
    assert said.startswith("3 episodes, 3 in all")
    assert proxy.cuts >= 6


def test_agent_forgets_another_hub_although_welcomes_of_the_next_are_lost(agent: Agent) -> None:
    # An agent that kept the count of the first hub would answer nothing to the second.
    second = Hub(HubConfig(bind=("tcp://127.0.0.1:*",)))
    url = second.endpoints[0]
    with (
        serving(url, SkeletonEnvironment()),
        second.in_background(),
        WelcomeThief() as thief,
        table_for(agent, SkeletonEnvironment(), thief.before) as glue,
    ):
        glue.rl_init()
        assert glue.rl_episode()
        thief.lead_to(url, lose=2)
        with connect(url) as other:
            other.rl_init()
            assert other.rl_episode()
            assert thief.lost
            assert other.rl_agent_message("?").startswith("1 episodes")
        second.stop("over")


def test_environment_agent_and_experiment_that_know_only_the_document_play_together() -> None:
    hub = Hub(HubConfig(bind=("tcp://127.0.0.1:*",)))
    url = hub.endpoints[0]
    environment = [sys.executable, str(PYTHON / "environment.py"), url, "foreign"]
    experiment = [sys.executable, str(PYTHON / "experiment.py"), url, "foreign"]
    with running(environment), running([*python_agent(url), "foreign"]), hub.in_background():
        done = subprocess.run(experiment, capture_output=True, text=True, timeout=60)

    assert done.returncode == 0, done.stderr
    task_spec, *episodes, said = done.stdout.splitlines()
    assert task_spec.startswith("VERSION RL-Glue-3.0")
    assert episodes == [f"episode {n}: return 1, 10 steps, ended" for n in (1, 2, 3)]
    assert said.startswith("3 episodes, 3 in all")
