"""One container at a time, in the real engine."""

from __future__ import annotations

import json
import os
import socket
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from experiment_runner.competition.containers import Container, Containers
from experiment_runner.competition.jail import LABEL
from experiment_runner.competition.launching import SOCKET, Launch
from experiment_runner.competition.settings import Entrant, Limits
from glue.errors import ConfigError
from tests.system.runs import wait_until

_MEBIBYTE = 2**20
_SECONDS = 120.0
_NOBODY = 65534
_LIMITS = Limits(memory=64 * _MEBIBYTE, tmp=2 * _MEBIBYTE, shm=3 * _MEBIBYTE, log=4096, pids=20, cpus=0.5)

_EATER = "x = []\nwhile True: x.append(bytearray(2 ** 20))"
_PARENT_OF_AN_EATER = (
    f"import subprocess, sys, time\nsubprocess.call([sys.executable, '-c', {_EATER!r}])\ntime.sleep(1000)"
)

Run = Callable[..., Container]


@pytest.fixture
def launch(tmp_path: Path) -> Iterator[Launch]:
    folder = tmp_path / "launch"
    folder.mkdir()
    with socket.socket(socket.AF_UNIX) as listening:
        listening.bind(str(folder / SOCKET))
        listening.listen()
        yield Launch(folder, "easy/honest/0", tmp_path / "log", f"test {tmp_path}")


@pytest.fixture
def run(image: Callable[..., str], launch: Launch) -> Iterator[Run]:
    """Return a function that runs a Python program in a jail."""
    containers = Containers()
    started: list[Container] = []

    def run(program: str, *lines: str) -> Container:
        command = json.dumps(["python3", "-u", "-c", program])
        entrant = Entrant("alice", image=image("USER 1234:1234", *lines, f"CMD {command}"))
        container = containers.start(entrant, _LIMITS, launch)
        assert isinstance(container, Container)
        started.append(container)
        return container

    yield run
    for container in started:
        container.stop()


def printed(container: Container) -> str:
    """Wait for a program to end, and return its output."""
    assert container.wait(_SECONDS)
    container.stop()
    return container.log.read_text(errors="replace")


def test_it_has_no_privileges_and_no_network(run: Run) -> None:
    said = printed(
        run(
            "import os\n"
            "import resource, socket\n"
            "print(*(name for _, name in socket.if_nameindex()))\n"
            "for name in ('MSGQUEUE', 'CORE', 'SIGPENDING', 'NOFILE'):\n"
            "    print(name, *resource.getrlimit(getattr(resource, 'RLIMIT_' + name, 11)))\n"
            "for line in open('/proc/self/status'):\n"
            "    if line.startswith(('Cap', 'NoNew', 'Seccomp')): print(line, end='')\n"
            "for line in open('/proc/mounts'): print(*line.split()[1:4:2])\n"
        )
    )
    assert said.startswith("lo\n")
    for line in (
        *("CORE 0 0", "SIGPENDING 256 256", "NOFILE 1024 1024"),
        *("CapEff:\t0000000000000000", "CapBnd:\t0000000000000000", "NoNewPrivs:\t1", "Seccomp:\t2"),
    ):
        assert line in said
    mounts = {
        path: flags.split(",") for path, _, flags in (line.partition(" ") for line in said.splitlines())
    }
    assert "ro" in mounts["/"]
    assert "ro" in mounts["/run/glue"]
    assert {"rw", "nosuid", "nodev", "noexec"} <= set(mounts["/tmp"])


@pytest.mark.parametrize("program", [_EATER, _PARENT_OF_AN_EATER])
def test_too_much_memory_is_the_reason_in_whichever_process(run: Run, program: str) -> None:
    container = run(program)
    assert container.wait(_SECONDS)
    assert container.reason == container.offence == "used more than 64 MiB of memory"


def test_how_it_ended_is_said_as_of_any_program(run: Run) -> None:
    for program, reason in (
        ("raise SystemExit(3)", "ended with status 3"),
        ("import os; os.kill(os.getpid(), 11)", "ended with status 139, as if by signal 11"),
        ("raise SystemExit(137)", "ended with status 137, as if by signal 9"),
    ):
        container = run(program)
        assert container.wait(_SECONDS)
        assert container.reason == reason


def test_the_last_words_are_kept(run: Run) -> None:
    said = printed(run("import sys; sys.stderr.write('x' * 10_000); raise RuntimeError('my mistake')"))
    assert said.endswith("RuntimeError: my mistake\n")
    assert len(said) == _LIMITS.log


def test_it_is_charged_for_all_its_programs(run: Run) -> None:
    container = run("import os, time\nif os.fork(): time.sleep(1000)\nwhile True: pass")
    wait_until(lambda: (container.processor or 0.0) > 0.2, "its child to use a processor")
    container.stop()
    assert (container.processor or 0.0) > 0.2
    assert (container.peak or 0) > _MEBIBYTE


def test_what_an_organiser_that_was_killed_left_is_swept(engine: Any, run: Run, launch: Launch) -> None:
    run("import time; time.sleep(1000)")
    Containers().sweep("another run")
    assert len(engine.containers.list(filters={"label": f"{LABEL}={launch.run}"})) == 1
    Containers().sweep(launch.run)
    assert not engine.containers.list(all=True, filters={"label": f"{LABEL}={launch.run}"})


_STARTER = """
import sys, time
from pathlib import Path
from experiment_runner.competition.containers import Containers
from experiment_runner.competition.settings import Entrant, Limits
from experiment_runner.competition.launching import Launch

image, folder, run = sys.argv[1:]
Containers().start(Entrant("alice", image=image), Limits(), Launch(Path(folder), "s", Path("log"), run))
print("started", flush=True)
time.sleep(1000)
"""


def test_it_ends_with_whoever_started_it(engine: Any, image: Callable[..., str], launch: Launch) -> None:
    tag = image("USER 1234:1234", "CMD sleep 1000")
    starter = subprocess.Popen(
        [sys.executable, "-c", _STARTER, tag, str(launch.folder), launch.run], stdout=subprocess.PIPE
    )
    assert starter.stdout is not None
    with starter.stdout:
        assert starter.stdout.readline() == b"started\n"
    label = {"label": f"{LABEL}={launch.run}"}
    assert len(engine.containers.list(filters=label)) == 1
    starter.kill()
    starter.wait()
    wait_until(
        lambda: not engine.containers.list(all=True, filters=label, ignore_removed=True),
        "the end of the container",
    )


@pytest.mark.parametrize(
    ("lines", "reason"),
    [
        (['ENTRYPOINT ["/no/such/program"]'], "ended with status 127"),
        (["WORKDIR /a", "RUN rmdir /a && touch /a"], "could not be started: "),
        (["RUN rm -rf /run/glue && ln -s /proc/self /run/glue"], "could not be started: "),
    ],
)
def test_what_the_engine_says_of_an_image_is_its_entrants_affair(
    lines: list[str], reason: str, image: Callable[..., str], launch: Launch
) -> None:
    entrant = Entrant("alice", image=image("CMD id", *lines))
    container = Containers().start(entrant, _LIMITS, launch)
    assert container.wait(_SECONDS)
    assert str(container.reason).startswith(reason)
    assert container.lost is None
    container.stop()
    assert launch.log.read_text()


@pytest.mark.parametrize("lines", [["USER 1000"], [], ["USER root"], ["USER nobody"]])
def test_every_jail_has_a_user_of_its_own(
    image: Callable[..., str], launch: Launch, lines: list[str]
) -> None:
    entrant = Entrant("alice", image=image(*lines, "CMD id -u; id -g; exec sleep 1000"))
    jails = [Containers().start(entrant, _LIMITS, replace(launch, log=launch.log / f"{i}")) for i in range(2)]
    launch.log.mkdir()
    for one in jails:
        one.wait(2.0)
        one.stop()
    users = [set(map(int, log.read_text().split())) for log in launch.log.iterdir()]
    assert [len(user) for user in users] == [1, 1]
    assert not users[0] & users[1]
    assert all(user <= set(range(40_000, 60_000)) for user in users)


def test_an_entrant_is_the_image_that_its_name_stood_for(image: Callable[..., str], launch: Launch) -> None:
    entrant = Entrant("alice", image=image("CMD echo the first"))
    entrant = replace(entrant, id=Containers().check(entrant, _LIMITS))
    command = ["docker", "build", "--quiet", "--tag", str(entrant.image), "-"]
    subprocess.run(command, input=f"FROM {entrant.id}\nCMD echo another".encode(), check=True, timeout=60)
    assert Containers().check(entrant, _LIMITS) == entrant.id
    assert Containers().check(replace(entrant, id=""), _LIMITS) != entrant.id
    container = Containers().start(entrant, _LIMITS, launch)
    assert container.wait(_SECONDS)
    container.stop()
    assert launch.log.read_text() == "the first\n"


def test_an_engine_that_is_away_is_waited_for(
    image: Callable[..., str], launch: Launch, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What becomes of one that goes away is in `test_attempts.py`."""
    entrant = Entrant("alice", image=image("CMD exec sleep 1000"))
    engine = os.environ.get("DOCKER_HOST", "unix:///var/run/docker.sock").removeprefix("unix://")
    monkeypatch.setenv("DOCKER_HOST", f"unix://{tmp_path}/engine")
    threading.Timer(3.0, (tmp_path / "engine").symlink_to, [engine]).start()
    container = Containers().start(entrant, _LIMITS, launch)
    assert container.lost is None
    container.stop()


def test_who_was_killed_at_the_engine_has_not_ended_by_itself(engine: Any, run: Run, launch: Launch) -> None:
    container = run("import time; time.sleep(1000)")
    (found,) = engine.containers.list(filters={"label": f"{LABEL}={launch.run}"})
    found.kill()
    assert container.wait(_SECONDS)
    assert "the container engine was told to kill" in str(container.lost)


@pytest.mark.parametrize(
    ("lines", "cpus", "why"),
    [
        (["CMD id"], 1024.0, "cpus = 1024, but this machine has only"),
        (["VOLUME /data", "CMD id"], 0.5, "declares a volume, /data"),
        (["CMD []"], 0.5, "has nothing to run"),
    ],
)
def test_what_cannot_be_jailed_is_found_before_anything_is_played(
    lines: list[str], cpus: float, why: str, image: Callable[..., str]
) -> None:
    with pytest.raises(ConfigError, match=why):
        Containers().check(Entrant("alice", image=image(*lines)), replace(_LIMITS, cpus=cpus))


def test_an_image_that_is_not_here(engine: Any) -> None:
    with pytest.raises(ConfigError, match=r"the image alice/agent:1 is not on this machine: .*docker pull"):
        Containers().check(Entrant("alice", image="alice/agent:1"), _LIMITS)


@pytest.mark.parametrize(
    ("address", "why"),
    [
        ("tcp://192.0.2.1:2375", r"DOCKER_HOST is tcp://192.0.2.1:2375.*engine must be here"),
        ("unix:///nowhere/docker.sock", r"no container engine answers at unix://.*start Docker"),
    ],
)
def test_an_engine_that_is_not_here(monkeypatch: pytest.MonkeyPatch, address: str, why: str) -> None:
    monkeypatch.setenv("DOCKER_HOST", address)
    with pytest.raises(ConfigError, match=why):
        Containers().check(Entrant("alice", image="alice/agent:1"), _LIMITS)


def test_an_engine_that_lets_only_others_in(monkeypatch: pytest.MonkeyPatch, launch: Launch) -> None:
    monkeypatch.setenv("DOCKER_HOST", f"unix://{launch.folder / SOCKET}")
    (launch.folder / SOCKET).chmod(0)
    user = os.geteuid()
    if user == 0:
        os.seteuid(_NOBODY)
    try:
        with pytest.raises(ConfigError, match=r"does not let this user in: .*usermod"):
            Containers().check(Entrant("alice", image="alice/agent:1"), _LIMITS)
    finally:
        os.seteuid(user)
