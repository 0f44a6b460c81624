"""Programs for the original RL-Glue, in C, and the servers that they play on: the original, and the gateway.

RLGLUE_C names the folder that the original RL-Glue is installed in, with `bin/rl_glue`; without it, only the
gateway is measured. Both need a C compiler.
"""

from __future__ import annotations

import os
import shutil
import socket
import subprocess
import tempfile
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

from benchmarks.measure import Rate, rate
from glue.hub.config import HubConfig, LegacyPort
from glue.hub.io.server import Hub
from glue.legacy.gateway import Gateway
from glue.types import Observation

_SOURCE = Path(__file__).with_name("original.c")

SERVER = Path(os.environ["RLGLUE_C"]) / "bin" / "rl_glue" if "RLGLUE_C" in os.environ else None
"""The original's server, if it is installed."""

compiler = shutil.which("cc")
"""The C compiler, if there is one."""


@contextmanager
def original_server() -> Iterator[tuple[int, list[int]]]:
    """Run the original server; yield its port and its process."""
    assert SERVER is not None
    with socket.create_server(("127.0.0.1", 0)) as probe:
        port = probe.getsockname()[1]
    environment = {**os.environ, "RLGLUE_PORT": str(port)}
    with subprocess.Popen([SERVER], env=environment, stdout=subprocess.DEVNULL) as server:
        try:
            yield port, [server.pid]
        finally:
            server.terminate()


@contextmanager
def through_the_gateway() -> Iterator[tuple[int, list[int]]]:
    """Run a hub with a port for original programs, in this process; yield the port."""
    hub = Hub(HubConfig(bind=("tcp://127.0.0.1:*",)))
    (port,) = Gateway(hub, [LegacyPort(0)]).ports
    with hub.in_background():
        yield port.port, []


@contextmanager
def original_programs(
    port: int, servers: list[int], observation: Observation, verb: str, steps: int
) -> Iterator[Callable[[], Rate]]:
    """Yield a measure of steps per second of three C programs at a server's port.

    Args:
        port: the server's port.
        servers: the server's processes, except this one.
        observation: the environment's observation.
        verb: `episode` or `step`.
        steps: number of steps of each measurement.
    """
    with ExitStack() as stack:
        folder = stack.enter_context(tempfile.TemporaryDirectory())
        program = f"{folder}/original"
        assert compiler is not None
        subprocess.run([compiler, "-O2", "-o", program, _SOURCE], check=True)

        def start(role: str) -> subprocess.Popen[str]:
            command = [program, role, str(port), *map(str, observation.counts)]
            process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
            return stack.enter_context(process)

        programs = [start(role) for role in ("environment", "agent", "experiment")]
        experiment = programs[-1]
        requests, replies = experiment.stdin, experiment.stdout
        assert requests is not None
        assert replies is not None

        def run() -> None:
            print(verb, steps, file=requests, flush=True)
            replies.readline()

        run()
        yield lambda: rate(run, steps, [*servers, *(program.pid for program in programs)])
        requests.close()
        experiment.wait()
