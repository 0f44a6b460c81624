"""The log of glue-hub at each level, and its end."""

from __future__ import annotations

import fcntl
import os
import re
import signal
import subprocess
import sys
from contextlib import suppress
from typing import Final

import pytest

from glue.client.experiment import connect
from tests.scripted.peer import TIMEOUT
from tests.scripted.process import address, address_in, running

PROGRAM: Final = "from glue_rl.commands import hub; hub()"

SLOW: Final = """
import time
from glue.system import threads

class Slow(threads.Thread):
    def start(self):
        super().start()
        if self.name == "hub":
            time.sleep(30)

threads.Thread = Slow
"""
"""Code that delays the main thread after the start of the hub's thread, as a busy machine may."""


def said(*options: str, program: str = PROGRAM) -> list[str]:
    """Return the lines that a hub logs after its address, while an experiment joins and leaves."""
    with running("-c", program, "--bind", "tcp://127.0.0.1:*", "--heartbeat", "0.05", *options) as hub:
        url = address(hub)
        with connect(url, "s") as glue:
            assert glue.rl_num_episodes() == 0
        with connect(url, "s"):
            pass  # once this one has joined, the hub knows that the first has left
        hub.terminate()
        _, rest = hub.communicate(timeout=TIMEOUT)
        return [line for line in rest.splitlines() if line not in ("", "interrupted")]


def test_lines_about_peers_have_the_time() -> None:
    lines = said()
    stamp = r"\d{4}-\d\d-\d\d \d\d:\d\d:\d\d "
    assert all(re.match(stamp, line) for line in lines)
    assert "session 's': experiment" in lines[0]
    assert not any("connected" in line for line in lines)
    assert any(line.endswith("stopped by SIGTERM") for line in lines), lines


def test_a_hub_that_is_stopped_while_it_starts_says_so() -> None:
    assert any(line.endswith("stopped by SIGTERM") for line in said(program=SLOW + PROGRAM))


def test_a_quiet_hub_logs_only_its_address() -> None:
    assert said("--quiet") == []


def test_a_verbose_hub_logs_every_connection() -> None:
    # Two programs connect; one that hears nothing for a few heartbeats of 50 ms reconnects.
    assert sum(line.endswith("connected") for line in said("--verbose")) >= 2


@pytest.mark.skipif(not hasattr(fcntl, "F_SETPIPE_SZ"), reason="needs the pipes of Linux")
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_hub_whose_full_log_is_not_read_can_be_stopped(number: signal.Signals) -> None:
    reading, writing = os.pipe()
    fcntl.fcntl(writing, fcntl.F_SETPIPE_SZ, 4096)
    command = [sys.executable, "-c", PROGRAM, "--bind", "tcp://127.0.0.1:*"]
    with subprocess.Popen(command, stderr=writing) as hub, open(reading, "rb", buffering=0) as log:
        try:
            url = address_in(log.readline().decode())
            # Opened again, so that the hub's own end still blocks.
            end = os.open(f"/proc/self/fd/{writing}", os.O_WRONLY | os.O_NONBLOCK)
            with suppress(BlockingIOError):  # the pipe is full
                while True:
                    os.write(end, b"x")
            with connect(url) as glue:
                assert glue.rl_num_episodes() == 0  # joining is logged
            hub.send_signal(number)
            assert hub.wait(TIMEOUT) == 128 + number
        finally:
            hub.kill()
            os.close(writing)
            os.close(end)
