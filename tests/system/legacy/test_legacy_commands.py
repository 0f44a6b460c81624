"""Original programs and the commands, each in a process of its own."""

from __future__ import annotations

import json
import re
import resource
import signal
import socket
import subprocess
import sys
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path

import pytest

from experiment_runner.meeting.players import HubOptions, Meeting, listening, open_experiment
from experiment_runner.plan.plan import Plan, RoleSweep
from glue.hub.config import LegacyPort
from tests.system.conformance import SCENARIOS
from tests.system.legacy.legacy_client import STYLES, TIMEOUT, Connection
from tests.system.legacy.legacy_rig import free_ports, play_agent

BIN = Path(sys.executable).parent
ROOT = Path(__file__).parents[3]


class Command:
    """A running command, and the ports that it has announced as open, by session."""

    def __init__(self, process: subprocess.Popen[str], ports: int) -> None:
        self.process = process
        self.ports: dict[str, int] = {}
        assert process.stderr is not None
        for line in process.stderr:
            if found := re.search(r"programs .*on 127\.0\.0\.1:(\d+), session '(.*)'", line):
                self.ports[found[2]] = int(found[1])
                if len(self.ports) == ports:
                    return
        raise AssertionError("the command ended without having opened its ports")

    def end(self) -> tuple[int, str, str]:
        """Wait for the end; return the status, standard output and standard error."""
        out, err = self.process.communicate(timeout=TIMEOUT)
        return self.process.returncode, out, err


@contextmanager
def command(*arguments: str, ports: int = 1, before: Callable[[], None] = lambda: None) -> Iterator[Command]:
    """Run a command that opens this number of ports."""
    process = subprocess.Popen(
        [BIN / arguments[0], *arguments[1:]],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=before,
    )
    try:
        yield Command(process, ports)
    finally:
        process.kill()
        process.communicate()


@contextmanager
def program(role: str, scenario: str, port: int, style: str) -> Iterator[subprocess.Popen[str]]:
    """Run an original program."""
    process = subprocess.Popen(
        [sys.executable, "-m", "tests.system.legacy.legacy_rig", role, scenario, str(port), style],
        cwd=ROOT,
        stdout=subprocess.PIPE,
        text=True,
    )
    try:
        yield process
    finally:
        process.kill()
        process.communicate()


def test_a_hub_joins_original_programs_by_their_ports_and_says_goodbye_when_it_is_stopped() -> None:
    bind = "tcp://127.0.0.1:*"
    options = ("--legacy-port", "*", "--legacy-port", "*=other")
    with command("glue-hub", "--bind", bind, *options, ports=2) as hub:
        port, other = hub.ports["default"], hub.ports["other"]
        with (
            program("agent", "test_1", port, "java") as agent,
            program("environment", "test_1", port, "python") as environment,
            program("agent", "test_1", other, "c") as waiting,
            program("experiment", "test_1", port, "c") as experiment,
        ):
            assert experiment.communicate(timeout=TIMEOUT)[0] == "test_1 passed\n"
            assert agent.wait(TIMEOUT) == environment.wait(TIMEOUT) == experiment.returncode == 0
            assert waiting.poll() is None
            assert hub.process.stderr is not None
            for line in hub.process.stderr:
                if "session 'other': agent" in line:
                    break
            hub.process.send_signal(signal.SIGTERM)
            assert waiting.wait(TIMEOUT) == 0
        assert hub.end()[0] == 128 + signal.SIGTERM


def test_an_experiment_waits_for_an_original_agent(tmp_path: Path) -> None:
    options = ("--env", "skeleton", "--episodes", "5", "--max-steps", "50", "--json")
    with command(
        "glue-experiment", *options, "--legacy-port", "*", "--out", str(tmp_path / "run")
    ) as running:
        with program("agent", "skeleton", running.ports["default"], "java") as agent:
            assert agent.wait(TIMEOUT) == 0
        status, out, err = running.end()
    assert status == 0, err
    assert json.loads(out.splitlines()[-1])["episodes"] == 5


def play_skeleton(port: int, style: str) -> None:
    """Connect as an original agent as soon as the port is open, and play until the goodbye."""
    play_agent(SCENARIOS["skeleton"].agent(), Connection(port, STYLES[style]))


@pytest.mark.parametrize("style", ["c", "java", "python"])
def test_an_original_agent_that_waits_for_its_port_is_never_cut_off(style: str, tmp_path: Path) -> None:
    for attempt in range(3):
        (port,) = free_ports(1)
        play = ["--env", "skeleton", "--episodes", "2", "--max-steps", "9", "--out", f"run-{attempt}"]
        meet = ["--bind", "tcp://127.0.0.1:*", "--legacy-port", str(port)]
        with ThreadPoolExecutor() as pool:
            agent = pool.submit(play_skeleton, port, style)
            done = subprocess.run(
                [BIN / "glue-experiment", *play, *meet],
                cwd=tmp_path,
                capture_output=True,
                text=True,
                timeout=TIMEOUT,
            )
            agent.result(TIMEOUT)
        assert done.returncode == 0, done.stderr


def test_an_original_agent_that_connects_before_there_is_a_hub_joins_the_first_trial() -> None:
    port = LegacyPort(0)
    options = HubOptions(bind=("tcp://127.0.0.1:*",), legacy=(port,))
    plan = Plan(episodes=1, trials=2, environments=(RoleSweep("skeleton"),))
    lines: list[str] = []
    with listening(plan, Meeting(hub=options), lines.append) as meeting, ThreadPoolExecutor() as pool:
        number = meeting.opened_legacy[port].port
        for spec in plan.expand():
            agent = pool.submit(play_skeleton, number, "c")
            with open_experiment(spec, meeting, lines.append, lambda: 0) as glue:
                glue.rl_init()
                assert glue.rl_episode(9) in (True, False)
            agent.result(TIMEOUT)


def test_a_hub_out_of_descriptors_serves_those_it_has_and_later_the_others() -> None:
    def few_descriptors() -> None:
        resource.setrlimit(resource.RLIMIT_NOFILE, (40, 40))

    options = ("--bind", "tcp://127.0.0.1:*", "--heartbeat", "0.1", "--timeout", "0.5", "--legacy-port", "*")
    with command("glue-hub", *options, before=few_descriptors) as hub:
        port = hub.ports["default"]
        crowd = [socket.create_connection(("127.0.0.1", port), TIMEOUT) for _ in range(60)]
        with (
            program("agent", "test_sanity", port, "c") as agent,
            program("environment", "test_sanity", port, "c") as environment,
            program("experiment", "test_sanity", port, "c") as experiment,
        ):
            # The crowd sends nothing, and so is dropped after a while.
            assert experiment.communicate(timeout=TIMEOUT)[0] == "test_sanity passed\n"
            assert agent.wait(TIMEOUT) == environment.wait(TIMEOUT) == 0
        for connection in crowd:
            connection.close()
        hub.process.send_signal(signal.SIGINT)
        assert "cannot accept a connection for now" in hub.end()[2]
