"""Players in the hub's own process and in programs of their own: the results are the same."""

from __future__ import annotations

import socket
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from glue import make, make_agent
from glue.client.experiment import connect_over
from glue.engine.experiment import Experiment
from glue.engine.local import local
from glue.errors import ConfigError, PeerFailed
from glue.hub.io.inside import InsideTransport, host
from glue.pace import Pace
from glue.types import Action, Observation
from glue.wire.messages import Role
from tests.hubs import running, serving
from tests.players import ScriptedAgent, ScriptedEnvironment, failing

ARRANGEMENTS = [frozenset[Role](), {Role.ENVIRONMENT}, {Role.AGENT}, {Role.ENVIRONMENT, Role.AGENT}]


@contextmanager
def arranged(inside: Any, agent: Any, environment: Any, **settings: Any) -> Iterator[Experiment]:
    """Yield the experiment of a hub with some players inside and the others on sockets."""
    players = {Role.AGENT: agent, Role.ENVIRONMENT: environment}
    outside = [player for role, player in players.items() if role not in inside]
    with (
        running(*outside, heartbeat=0.05, **settings) as hub,
        connect_over(InsideTransport(hub, {role: players[role] for role in inside})) as glue,
    ):
        glue.wait_for_players(lambda missing: None)
        yield glue


def play(glue: Experiment, seed: int, max_steps: int) -> list[object]:
    """Play episodes as a whole and step by step; return everything that an experiment sees."""
    shown: list[object] = [glue.rl_init(seed=seed)]
    for _ in range(5):
        shown += [glue.rl_episode(max_steps), glue.rl_return(), glue.rl_num_steps()]
    shown.append(glue.rl_start())
    shown += [glue.rl_step() for _ in range(3)]
    shown += [glue.rl_num_episodes(), glue.rl_agent_message("how?"), glue.rl_env_message("where?")]
    return shown


@pytest.mark.parametrize("inside", ARRANGEMENTS, ids=["none", "environment", "agent", "both"])
@pytest.mark.parametrize(("environment", "agent"), [("mines", "sarsa"), ("mines", "random")])
@pytest.mark.parametrize(("seed", "max_steps"), [(1, 0), (2, 7)])
def test_results_are_those_of_one_process(
    inside: Any, environment: str, agent: str, seed: int, max_steps: int
) -> None:
    with arranged(inside, make_agent(agent), make(environment)) as glue:
        result = play(glue, seed, max_steps)
        learned = glue.rl_agent_save() if agent == "sarsa" else b""
    with local(make_agent(agent), make(environment)) as expected:
        assert play(expected, seed, max_steps) == result
        assert learned == (expected.rl_agent_save() if agent == "sarsa" else b"")


@pytest.mark.parametrize("role", [Role.AGENT, Role.ENVIRONMENT])
def test_a_player_that_raises_inside_fails_as_outside(role: Role, capsys: pytest.CaptureFixture[str]) -> None:
    failures = []
    fails = failing("agent_step" if role is Role.AGENT else "env_step", ValueError("out of ideas"))
    for inside in (frozenset[Role](), {role}):
        agent, environment = ScriptedAgent(), ScriptedEnvironment()
        (agent if role is Role.AGENT else environment).before = fails
        with arranged(inside, agent, environment) as glue:
            glue.rl_init()
            with pytest.raises(PeerFailed, match="ValueError: out of ideas") as failed:
                glue.rl_episode(9)
            failures.append(str(failed.value))
        assert "out of ideas" in capsys.readouterr().err, "the traceback is shown"
    assert failures[0] == failures[1]


def test_a_notebook_hosts_an_environment_for_an_agent_from_outside(tmp_path: Path) -> None:
    url = f"ipc://{tmp_path}/hub"
    with local(make_agent("sarsa"), make("mines")) as alone:
        expected = play(alone, 5, 50)
    with serving(url, make_agent("sarsa")), host(environment=make("mines"), bind=url) as glue:
        assert play(glue, 5, 50) == expected


def test_hosting_needs_a_player_and_a_free_address() -> None:
    with pytest.raises(ConfigError), host():
        pass
    with socket.create_server(("127.0.0.1", 0)) as taken:
        url = f"tcp://127.0.0.1:{taken.getsockname()[1]}"
        with pytest.raises(ConfigError), host(ScriptedAgent(), bind=url):
            pass


class Dawdler(ScriptedAgent):
    """Answers agent_step when the environment has made five steps more, or the episode is over."""

    def __init__(self, environment: ScriptedEnvironment) -> None:
        super().__init__(environment.calls)
        self._environment = environment

    def agent_step(self, reward: float, observation: Observation) -> Action:
        action = super().agent_step(reward, observation)
        until = min(self._environment._steps + 5, self._environment.length)
        while self._environment._steps < until:
            time.sleep(0.001)
        return action


@pytest.mark.parametrize("inside", [frozenset[Role](), frozenset({Role.ENVIRONMENT})])
def test_an_environment_with_a_rate_does_not_wait(inside: frozenset[Role]) -> None:
    environment = ScriptedEnvironment(30, 1.0, [])
    with arranged(inside, Dawdler(environment), environment, pace=Pace(rate=500.0)) as glue:
        glue.rl_init()
        assert glue.rl_episode()
        assert glue.rl_return() == 30.0
        calls = list(environment.calls)
    given = [float(call.split()[1]) for call in calls if call.startswith(("agent_step", "agent_end"))]
    assert sum(given) == 30.0  # no reward is lost
    assert len(given) <= 8


def test_an_agent_in_the_process_of_the_hub_cannot_be_late() -> None:
    with (
        pytest.raises(ConfigError, match="would keep the environment waiting"),
        host(ScriptedAgent(), bind="tcp://127.0.0.1:*", pace=Pace(rate=10.0)),
    ):
        pass
