"""Original programs and the commands."""

from __future__ import annotations

import os
import resource
import signal
import socket
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from pathlib import Path

from experiment_runner.executors.job import HubOptions, Placement
from experiment_runner.executors.over_hub import listening
from experiment_runner.executors.players import open_experiment
from experiment_runner.plan.plan import Plan, RoleSweep
from glue import load_run
from glue.hub.config import LegacyPort
from tests.players import ScriptedAgent
from tests.system.conformance import SCENARIOS
from tests.system.legacy.legacy_client import STYLES, TIMEOUT, Connection, OriginalExperiment, play
from tests.terminal import Terminal

BIND = ("--bind", "tcp://127.0.0.1:*")
CASE = SCENARIOS["test_1"]


def port(command: Terminal, session: str = "default") -> int:
    """Return the port that a command has announced for a session."""
    return int(command.wait_for(rf"programs .*on 127\.0\.0\.1:(\d+), session '{session}'")[1])


def play_case(number: int, pool: ThreadPoolExecutor) -> None:
    """Let three original programs meet at a port, and play."""
    players = (
        pool.submit(play, CASE.agent(), Connection(number, STYLES["java"])),
        pool.submit(play, CASE.environment(), Connection(number, STYLES["python"])),
    )
    with OriginalExperiment(Connection(number)) as glue:
        CASE.run(glue)
    for player in players:
        player.result(TIMEOUT)


def test_a_hub_joins_original_programs_by_their_ports_and_says_goodbye_when_it_is_stopped(
    tmp_path: Path,
) -> None:
    ports = ("--legacy-port", "*", "--legacy-port", "*=other")
    with closing(Terminal("glue-hub", *BIND, *ports, cwd=tmp_path)) as hub, ThreadPoolExecutor() as pool:
        waiting = pool.submit(play, CASE.agent(), Connection(port(hub, "other")))
        play_case(port(hub), pool)
        hub.wait_for("session 'other': agent")
        hub.send_signal(signal.SIGTERM)
        waiting.result(TIMEOUT)
        assert hub.end() == 128 + signal.SIGTERM


def test_each_trial_takes_another_original_agent_and_all_are_one_setting(tmp_path: Path) -> None:
    options = "--env skeleton --episodes 2 --max-steps 1 --trials 2 --seed 7 --legacy-port * --out run"
    with closing(Terminal("glue-experiment", *options.split(), *BIND, cwd=tmp_path)) as experiment:
        for style in ("python", "java"):
            agent = ScriptedAgent()
            play(agent, Connection(port(experiment), STYLES[style]))
            # Truncated after its first step, an episode ends without a call.
            assert [call.split()[0] for call in agent.calls[1:-1]] == ["agent_start"] * 2
        assert experiment.end() == 0, experiment.lines
    assert load_run(tmp_path / "run")["agent"].tolist() == ["original agent"] * 4


def test_an_original_agent_that_connects_before_there_is_a_hub_joins_the_first_trial() -> None:
    here = LegacyPort(0)
    options = HubOptions(bind=("tcp://127.0.0.1:*",), legacy=(here,))
    plan = Plan(episodes=1, trials=2, environments=(RoleSweep("skeleton"),))
    said: list[object] = []
    with listening(plan, Placement(hub=options), said.append) as placement, ThreadPoolExecutor() as pool:
        number = placement.opened_legacy[here].port
        for spec in plan.expand():
            agent = pool.submit(play, SCENARIOS["skeleton"].agent(), Connection(number))
            with open_experiment(spec, placement, said.append, lambda: 0) as glue:
                glue.rl_init()
                assert glue.rl_episode(9) in (True, False)
            agent.result(TIMEOUT)


def test_a_hub_out_of_descriptors_serves_those_it_has_and_later_the_others(tmp_path: Path) -> None:
    options = (*BIND, "--legacy-port", "*", "--legacy-port", "*=other")
    with closing(Terminal("glue-hub", *options, cwd=tmp_path)) as hub, ThreadPoolExecutor() as pool:
        number = port(hub)
        with closing(OriginalExperiment(Connection(port(hub, "other")))) as inside:
            assert inside.rl_num_steps() == 0
            most = 10 + max(map(int, os.listdir(f"/proc/{hub.process.pid}/fd")))
            resource.prlimit(hub.process.pid, resource.RLIMIT_NOFILE, (most, most))
            crowd = [socket.create_connection(("127.0.0.1", number), TIMEOUT) for _ in range(20)]
            hub.wait_for("cannot accept a connection for now")
            assert inside.rl_num_steps() == 0
            for connection in crowd:
                connection.close()
            play_case(number, pool)
