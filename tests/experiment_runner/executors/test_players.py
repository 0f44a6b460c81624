from __future__ import annotations

import contextlib
import math
import re
import threading
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import pytest

from agents.baselines import RandomAgent, SkeletonAgent
from env_server.toys import MinesEnvironment, SkeletonEnvironment
from experiment_runner.executors.job import BOTH, HubOptions, Placement, Report
from experiment_runner.executors.over_hub import hints
from experiment_runner.executors.players import open_experiment
from experiment_runner.executors.rewards import FiniteRewards
from experiment_runner.plan.limits import TrialId
from experiment_runner.plan.plan import RoleSpec, TrialSpec
from glue import Action, Agent, Observation, Step, observe, serve_agent, serve_environment
from glue.console import say_why_slow
from glue.errors import GlueError, PeerFailed, PeerLost, Refused
from glue.hub.config import LegacyPort
from glue.wire.messages import Role
from tests.forked import run

LOCAL = "tcp://127.0.0.1:*"
REMOTE = TrialSpec(TrialId("remote/mines/0"), None, RoleSpec("mines"), episodes=1, max_steps=0, seed=1)


class Heard(Exception):
    """The hint was given."""


@pytest.mark.parametrize(
    ("url", "session", "ports", "hint"),
    [
        ("tcp://127.0.0.1:4097", "default", (), ""),
        ("tcp://0.0.0.0:9", "default", (), " --hub tcp://HOST:9"),
        ("tcp://[::]:9", "default", (), " --hub tcp://HOST:9"),
        ("tcp://127.0.0.1:9", "b", (), " --hub tcp://127.0.0.1:9 --session b"),
        (
            "tcp://127.0.0.1:4097",
            "b",
            (LegacyPort(7), LegacyPort(8, "b")),
            " --session b; or an original one on 127.0.0.1:8",
        ),
    ],
)
def test_hint_says_where_others_can_join(
    url: str, session: str, ports: Sequence[LegacyPort], hint: str
) -> None:
    lines: list[str] = []
    show = hints(lines.append, url, session, {Role.ENVIRONMENT}, ports)
    for missing in (BOTH, {Role.AGENT}, BOTH):
        show(missing)
    agent = f"waiting for an agent; in another terminal: glue-agent hierarchical{hint}"
    assert lines == [agent, "waiting for the environment to start", agent, agent]


def test_stranger_cannot_take_the_seat_of_a_player_that_is_named() -> None:
    """Nor can it keep the experiment from starting the player."""
    hub: list[str] = []

    def send(report: Report) -> None:
        if found := re.search(r"glue-agent hierarchical --hub (\S+)'", str(report)):
            hub.append(found[1])
            with pytest.raises(Refused):
                serve_environment(MinesEnvironment(), found[1])
            raise Heard

    placement = Placement(hub=HubOptions(bind=(LOCAL,)))
    with pytest.raises(Heard), open_experiment(REMOTE, placement, send, lambda: 0):
        raise AssertionError("an agent was missing")
    assert hub


def test_an_address_serves_observers_if_no_player_is_expected(tmp_path: Path) -> None:
    address = f"ipc://{tmp_path}/hub"
    spec = replace(REMOTE, agent=RoleSpec("random"))
    placement = Placement(hub=HubOptions(bind=(address,)))
    with open_experiment(spec, placement, lambda report: None, lambda: 0), observe(address, wait=5):
        pass


def test_reward_that_is_not_finite_is_noticed_in_a_list_too() -> None:
    class Lists(SkeletonEnvironment):
        def env_step(self, action: Action) -> Step:
            return [math.nan, Observation(ints=[1]), False]  # type: ignore[return-value]

    with pytest.raises(GlueError, match="step 1 is nan"):
        FiniteRewards(Lists()).env_step(Action(ints=[1]))


class Odd(SkeletonEnvironment):
    """Its third reward is not finite."""

    def __init__(self, *, reward: str = "") -> None:
        super().__init__()
        self._steps, self._reward = 0, reward

    def env_step(self, action: Action) -> Step:
        self._steps += 1
        step = super().env_step(action)
        return step._replace(reward=float(self._reward)) if self._steps == 3 else step


@pytest.mark.parametrize(
    ("placement", "reward"),
    [*((Placement(BOTH), reward) for reward in (math.nan, math.inf, -math.inf)), (Placement(), math.nan)],
)
def test_reward_that_is_not_finite_ends_the_trial_with_environment_and_step(
    placement: Placement, reward: float
) -> None:
    environment = RoleSpec(f"{__file__}:Odd", {"reward": str(reward)})
    spec = replace(REMOTE, agent=RoleSpec("skeleton"), environment=environment)
    with open_experiment(spec, placement, lambda report: None, lambda: 0) as glue:
        glue.rl_init(1)
        with pytest.raises(PeerFailed, match=f"Odd.* step 3 is {reward}"):
            glue.rl_episode(10)
    if placement.in_process:
        with open_experiment(spec, Placement(BOTH, any_reward=True), lambda report: None, lambda: 0) as glue:
            glue.rl_init(1)
            glue.rl_episode(10)
            assert not math.isfinite(glue.rl_return())


class Left(Agent):
    def agent_start(self, observation: Observation) -> Action:
        return Action([2])

    def agent_step(self, reward: float, observation: Observation) -> Action:
        return Action([2])


@pytest.mark.parametrize("placement", [Placement(BOTH), Placement()])
def test_an_action_that_the_mask_forbids_ends_the_trial_if_actions_are_checked(placement: Placement) -> None:
    environment = RoleSpec("mines", {"masks": True})
    spec = replace(REMOTE, agent=RoleSpec(f"{__file__}:Left"), environment=environment)
    with open_experiment(
        spec, replace(placement, check_actions=True), lambda report: None, lambda: 0
    ) as glue:
        glue.rl_init(1)
        with pytest.raises(PeerFailed, match=r"Mines.* int 0 is 2, and the mask of .* is \d{4}"):
            glue.rl_episode(10)


def test_hint_is_given_again_when_a_player_from_outside_is_lost() -> None:
    """The line is printed again, since the terminal has scrolled by then."""
    shown: list[str] = []

    class Leaving(SkeletonAgent):
        def agent_start(self, observation: Observation) -> Action:
            raise KeyboardInterrupt

    def join_and_leave(url: str) -> None:
        with contextlib.suppress(KeyboardInterrupt):
            serve_agent(Leaving(), url)

    def send(report: Report) -> None:
        if found := re.search(r"waiting for an agent; .* --hub (\S+)'", str(report)):
            shown.append(found[0])
            if len(shown) == 1:
                threading.Thread(target=join_and_leave, args=(found[1],), daemon=True).start()

    spec = replace(REMOTE, environment=RoleSpec("skeleton"))
    placement = Placement(hub=HubOptions(bind=(LOCAL,)))
    with open_experiment(spec, placement, send, lambda: 0) as glue:
        glue.rl_init(1)
        with pytest.raises(PeerLost):
            glue.rl_episode(9)
    assert shown == shown[:1] * 2


class Compiling(RandomAgent):
    def agent_init(self, task_spec: str) -> None:
        say_why_slow("compiling its policy")
        super().agent_init(task_spec)


def test_a_player_that_compiles_says_so_once_in_the_terminal_of_the_experiment(tmp_path: Path) -> None:
    players = ("--env", "mines", "--agent", f"{__file__}:Compiling")
    shown = run("glue-experiment", *players, "--episodes", "1", cwd=tmp_path)
    assert shown.returncode == 0, shown.stderr
    assert shown.stderr.count("compiling its policy") == 1
    assert "agent Compiling: compiling its policy" in shown.stderr.splitlines()
