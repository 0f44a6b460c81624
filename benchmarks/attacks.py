"""Steps per second of a session while other connections misbehave."""

from __future__ import annotations

import itertools
import os
import select
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from typing import Final

from benchmarks.measure import Table, count, medians, ratio
from benchmarks.players import SIZES, serving
from glue.client.experiment import connect
from glue.hub.sessions import INSTANCE_SIZE
from glue.wire import zmtp
from glue.wire.codec import TO_HUB, encode
from glue.wire.messages import PROTOCOL_VERSION, Kind, Message

_STEPS: Final = 500
_READY: Final = b"\x04\x1c\x05READY\x0bSocket-Type\x00\x00\x00\x06DEALER"
_MALFORMED: Final = zmtp.encode([b"nonsense"])
_ENDLESS: Final = b"\x01\x00"
_CHUNK: Final = 1000
"""Number of messages sent by one system call."""

_CASES: Final = {
    "malformed messages": ("malformed", (1, 6, 60)),
    "a message without an end": ("endless", (4,)),
    "heartbeats from a seat": ("heartbeats", (1,)),
    "connections opened and closed": ("connects", (1,)),
    "requests that need no player": ("requests", (12,)),
}


def run() -> list[Table]:
    """Measure a session undisturbed and under each attack."""
    with ExitStack() as stack:
        hub = stack.enter_context(_hub())
        size = next(iter(SIZES))
        for role in ("environment", "agent"):
            stack.enter_context(serving(role, size, hub))
        glue = stack.enter_context(connect(hub, "0"))
        glue.rl_init()

        def undisturbed() -> float:
            began = time.perf_counter()
            glue.rl_episode(_STEPS)
            return _STEPS / (time.perf_counter() - began)

        def beside(attack: str, number: int) -> Callable[[], float]:
            attacker = stack.enter_context(_attacker(attack, hub, number))

            def measure() -> float:
                with _running(attacker):
                    return undisturbed()

            return measure

        cases = [
            (f"{name}, {number} of them", beside(attack, number))
            for name, (attack, numbers) in _CASES.items()
            for number in numbers
        ]
        alone, *results = medians([undisturbed, *(measure for _, measure in cases)])
    rows = [("undisturbed", count(alone), ratio(1.0))]
    rows += [
        (name, count(value), ratio(value / alone)) for (name, _), value in zip(cases, results, strict=True)
    ]
    return [
        Table(
            "A session beside connections that misbehave",
            "Over tcp: hub, agent, environment, experiment and the attacker are a process each. The attacker "
            "sends as fast as the hub takes it, and connects again when dropped. The aim is half of what "
            "the session makes undisturbed.",
            ("beside", "steps per second", "of undisturbed"),
            rows,
        )
    ]


@contextmanager
def _hub() -> Iterator[str]:
    command = [
        sys.executable,
        "-c",
        "from glue_rl.commands import hub; hub()",
        "--bind",
        "tcp://127.0.0.1:*",
    ]
    # Nobody reads its log, so a hub that waits for a reader would stand still.
    process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
    assert process.stderr is not None
    try:
        yield process.stderr.readline().partition("listening on ")[2].split()[0].removesuffix(":")
    finally:
        process.kill()
        process.wait()
        process.stderr.close()


@contextmanager
def _attacker(attack: str, url: str, number: int) -> Iterator[subprocess.Popen[bytes]]:
    """Start an attacker that is stopped, ready to continue."""
    process = subprocess.Popen([sys.executable, "-m", "benchmarks.attacks", attack, url, str(number)])
    try:
        os.waitid(os.P_PID, process.pid, os.WSTOPPED)
        yield process
    finally:
        process.kill()
        process.wait()


@contextmanager
def _running(attacker: subprocess.Popen[bytes]) -> Iterator[None]:
    attacker.send_signal(signal.SIGCONT)
    try:
        yield
    finally:
        attacker.send_signal(signal.SIGSTOP)
        os.waitid(os.P_PID, attacker.pid, os.WSTOPPED)


def _attack(attack: str, url: str, number: int) -> None:
    """Attack forever, over `number` connections; stop the process before the first attack.

    It waits while the hub takes nothing from it, so that its own use of the processor is not measured.
    """
    host, _, port = url.removeprefix("tcp://").rpartition(":")
    address = (host, int(port))
    os.kill(os.getpid(), signal.SIGSTOP)
    while attack == "connects":
        with suppress(OSError):
            socket.create_connection(address).close()
    connections: list[socket.socket] = []
    sessions = (f"{session}" for session in itertools.count(1))
    floods: dict[socket.socket, Iterator[bytes]] = {}
    left: dict[socket.socket, bytes] = {}
    while True:
        while len(connections) < number:
            session = next(sessions)
            connection = _connect(address, attack, session)
            connections.append(connection)
            floods[connection], left[connection] = _flood(attack, session), b""
        _, writable, _ = select.select([], connections, [])
        for connection in writable:
            data = left[connection] or next(floods[connection])
            try:
                left[connection] = data
                left[connection] = data[connection.send(data) :]
                with suppress(BlockingIOError):
                    connection.recv(65_536)
            except BlockingIOError:
                continue
            except OSError:
                connection.close()
                connections.remove(connection)


def _flood(attack: str, session: str) -> Iterator[bytes]:
    """Yield what is sent over a connection, without end."""
    if attack != "requests":
        heartbeat = zmtp.encode(encode(Message(Kind.HEARTBEAT, session, 1), TO_HUB))
        one = {"malformed": _MALFORMED, "endless": _ENDLESS}.get(attack, heartbeat)
        yield from itertools.repeat(one * _CHUNK)
    for seq in itertools.count(1, _CHUNK):
        requests = (Message(Kind.RL_NUM_EPISODES, session, seq + number) for number in range(_CHUNK))
        yield b"".join(zmtp.encode(encode(request, TO_HUB)) for request in requests)


def _connect(address: tuple[str, int], attack: str, session: str) -> socket.socket:
    connection = socket.create_connection(address)
    connection.sendall(zmtp.GREETING + _READY)
    role = {"heartbeats": "agent", "requests": "experiment"}.get(attack)
    if role is not None:
        scalars = ((PROTOCOL_VERSION,), role, os.urandom(INSTANCE_SIZE), "attacker", "benchmark", ())
        connection.sendall(zmtp.encode(encode(Message(Kind.HELLO, session, 0, scalars), TO_HUB)))
    connection.setblocking(False)
    return connection


if __name__ == "__main__":
    _attack(sys.argv[1], sys.argv[2], int(sys.argv[3]))
