"""One container at a time, in the real engine."""

from __future__ import annotations

import json
import os
import socket
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from experiment_runner.competition.containers import Container, Containers
from experiment_runner.competition.jail import LABEL
from experiment_runner.competition.settings import Entrant, Limits
from experiment_runner.competition.starters import SOCKET, Launch
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


def test_it_reaches_the_hub_and_finds_its_session_in_the_environment(run: Run) -> None:
    said = printed(
        run(
            "import os, socket\n"
            "path = os.environ['GLUE_HUB'].removeprefix('ipc://')\n"
            "socket.socket(socket.AF_UNIX).connect(path)\n"
            "print(os.environ['GLUE_SESSION'])\n"
        )
    )
    assert said == "easy/honest/0\n"


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


_SOCKETS = """
import socket
found = set()
for family in range(64):
    for kind in range(1, 11):
        for protocol in range(30):
            try: socket.socket(family, kind, protocol).close()
            except OSError: continue
            found.add((family, protocol if family == socket.AF_NETLINK else 0))
print(*sorted(found))
"""


def test_it_can_make_sockets_of_its_hub_and_of_its_loopback_interface_only(run: Run) -> None:
    """Without our own profile, Debian's engine lets a jail make AF_VSOCK and AF_XDP as well."""
    assert printed(run(_SOCKETS)) == "(1, 0) (2, 0) (10, 0) (16, 0)\n"


_LOAD = """
from pathlib import Path
names = [f'/proc/{name}' for name in ('loadavg', 'stat', 'meminfo', 'vmstat', 'uptime', 'interrupts')]
paths = [*map(Path, names), *Path('/proc/sys/fs').rglob('*'), *Path('/sys/devices/system/node').rglob('*')]
paths += [*Path('/sys/devices/system/cpu').glob('cpu*/*/*'), *Path('/sys/block').glob('*/stat')]
print(*(path for path in paths if path.is_file() and path.read_text()))
"""


def test_it_does_not_see_the_load_of_the_machine(run: Run) -> None:
    assert printed(run(_LOAD)) == "\n"


def test_what_it_may_use_is_limited(engine: Any, run: Run, launch: Launch) -> None:
    run("import time; time.sleep(1000)")
    (container,) = engine.containers.list(filters={"label": f"{LABEL}={launch.run}"})
    settings = container.attrs["HostConfig"]
    assert settings["Memory"] == settings["MemorySwap"] == _LIMITS.memory
    assert settings["PidsLimit"] == _LIMITS.pids
    assert settings["NanoCpus"] == 500_000_000
    assert settings["ShmSize"] == _LIMITS.shm
    assert settings["Init"] is True
    assert settings["CapDrop"] == ["ALL"]
    assert settings["NetworkMode"] == "none"


def test_disks_are_full_at_their_limits(run: Run) -> None:
    said = printed(
        run(
            "for folder in ('/tmp', '/dev/shm', '/var/tmp', '/run/glue', '/dev', '/'):\n"
            "    written = 0\n"
            "    try:\n"
            "        with open(folder + '/junk', 'wb', buffering=0) as file:\n"
            "            while True: written += file.write(bytes(2 ** 18))\n"
            "    except OSError as error: print(folder, written // 2 ** 20)\n"
        )
    )
    assert said.split() == [
        "/tmp",
        "2",
        "/dev/shm",
        "3",
        "/var/tmp",
        "0",
        "/run/glue",
        "0",
        "/dev",
        "0",
        "/",
        "0",
    ]


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


def test_nothing_of_it_is_left_when_it_is_stopped(engine: Any, run: Run, launch: Launch) -> None:
    program = (
        "import subprocess, time\n"
        "subprocess.Popen(['sleep', '1000'], start_new_session=True)\n"
        "print('started'); time.sleep(1000)\n"
    )
    container = run(program)
    assert not container.wait(0.0)
    assert container.reason is None
    container.stop()
    container.stop()
    assert container.reason is None
    assert not engine.containers.list(all=True, filters={"label": f"{LABEL}={launch.run}"})


def test_a_program_that_prints_without_end_waits_and_leaves_a_short_log(run: Run) -> None:
    container = run("while True: print('shout ' * 100)")
    assert not container.wait(2.0)
    container.stop()
    assert 0 < container.log.stat().st_size <= _LIMITS.log


def test_the_last_words_are_kept(run: Run) -> None:
    said = printed(run("import sys; sys.stderr.write('x' * 10_000); raise RuntimeError('my mistake')"))
    assert said.endswith("RuntimeError: my mistake\n")
    assert len(said) == _LIMITS.log


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
from experiment_runner.competition.starters import Launch

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


class Gateway:
    """Another address of the engine, which can be cut off."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._engine = os.environ.get("DOCKER_HOST", "unix:///var/run/docker.sock").removeprefix("unix://")
        self._open: list[socket.socket] = []

    def open(self) -> None:
        listening = socket.socket(socket.AF_UNIX)
        listening.bind(str(self.path))
        listening.listen()
        self._open.append(listening)
        threading.Thread(target=self._serve, args=(listening,), daemon=True).start()

    def cut(self) -> None:
        self.path.unlink()
        while self._open:
            one = self._open.pop()
            with suppress(OSError):
                one.shutdown(socket.SHUT_RDWR)
            one.close()

    def _serve(self, listening: socket.socket) -> None:
        with suppress(OSError):
            while True:
                client, _ = listening.accept()
                engine = socket.socket(socket.AF_UNIX)
                engine.connect(self._engine)
                self._open += [client, engine]
                for pair in ((client, engine), (engine, client)):
                    threading.Thread(target=self._pump, args=pair, daemon=True).start()

    @staticmethod
    def _pump(one: socket.socket, other: socket.socket) -> None:
        with suppress(OSError):
            while data := one.recv(2**16):
                other.sendall(data)
            other.shutdown(socket.SHUT_WR)


@pytest.fixture
def gateway(engine: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Gateway]:
    made = Gateway(tmp_path / "engine")
    monkeypatch.setenv("DOCKER_HOST", f"unix://{made.path}")
    made.open()
    yield made
    made.cut()


def test_an_engine_that_is_away_is_waited_for(
    gateway: Gateway, image: Callable[..., str], launch: Launch
) -> None:
    entrant = Entrant("alice", image=image("CMD exec sleep 1000"))
    containers = Containers()
    containers.check(entrant, _LIMITS)
    gateway.cut()
    threading.Timer(3.0, gateway.open).start()
    container = containers.start(entrant, _LIMITS, launch)
    assert container.lost is None
    gateway.cut()
    assert container.wait(_SECONDS)
    assert container.lost == "the container engine went away"
    threading.Timer(3.0, gateway.open).start()
    container.stop()


def test_who_was_killed_at_the_engine_has_not_ended_by_itself(engine: Any, run: Run, launch: Launch) -> None:
    container = run("import time; time.sleep(1000)")
    (found,) = engine.containers.list(filters={"label": f"{LABEL}={launch.run}"})
    found.kill()
    assert container.wait(_SECONDS)
    assert "the container engine was told to kill" in str(container.lost)


def test_more_processors_than_the_machine_has_are_found_before_anything_is_played(
    image: Callable[..., str],
) -> None:
    with pytest.raises(ConfigError, match="cpus = 1024, but this machine has only"):
        Containers().check(Entrant("alice", image=image("CMD id")), Limits(cpus=1024.0))


def test_an_image_with_a_volume_could_fill_the_disk(image: Callable[..., str]) -> None:
    with pytest.raises(ConfigError, match="declares a volume, /data"):
        Containers().check(Entrant("alice", image=image("VOLUME /data", "CMD id")), _LIMITS)


def test_an_image_without_a_command_has_nothing_to_run(image: Callable[..., str]) -> None:
    with pytest.raises(ConfigError, match="has nothing to run"):
        Containers().check(Entrant("alice", image=image("CMD []")), _LIMITS)


def test_an_image_that_is_not_here(engine: Any) -> None:
    with pytest.raises(ConfigError, match=r"the image alice/agent:1 is not on this machine: .*docker pull"):
        Containers().check(Entrant("alice", image="alice/agent:1"), _LIMITS)


def test_several_at_once(run: Run) -> None:
    containers = [run("print('here')") for _ in range(4)]
    assert [printed(container) for container in containers] == ["here\n"] * 4


def test_an_engine_elsewhere_cannot_reach_the_hub(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("DOCKER_HOST", "tcp://192.0.2.1:2375")
    with pytest.raises(ConfigError, match=r"DOCKER_HOST is tcp://192.0.2.1:2375.*engine must be here"):
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


def test_an_engine_that_is_not_there(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("DOCKER_HOST", f"unix://{tmp_path}/docker.sock")
    with pytest.raises(ConfigError, match=r"no container engine answers at unix://.*start Docker"):
        Containers().check(Entrant("alice", image="alice/agent:1"), _LIMITS)
