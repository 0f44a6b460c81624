"""Parts of the hub's loop: connections, and the log, which never blocks."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from glue.errors import ConfigError
from glue.hub.io.connection import Connection
from glue.hub.io.listener import open_address, reserve
from glue.hub.io.log import Log
from glue.hub.io.loop import Loop
from tests.scripted.peer import TIMEOUT


@contextmanager
def connected() -> Iterator[tuple[Connection, socket.socket]]:
    """A connection, and the socket at its other end."""
    loop = Loop(1.0, print)
    with socket.create_server(("127.0.0.1", 0)) as listening:
        other = socket.create_connection(listening.getsockname())
        accepted, _ = listening.accept()
    connection = Connection(loop, accepted, "other", 1.0)
    with other:
        yield connection, other
    connection.close()
    loop.close()


def test_a_port_that_is_reserved_can_be_opened_again_and_again_by_those_who_know() -> None:
    with open_address("tcp://127.0.0.1:*") as free:
        url = free.endpoint
    with reserve(url):
        for _ in range(2):
            with (
                open_address(url, reserved=True) as opened,
                socket.create_connection(("127.0.0.1", opened.port)),
            ):
                opened.socket.accept()[0].close()
            with pytest.raises(ConfigError, match="in use"):
                open_address(url)
            with pytest.raises(ConnectionRefusedError):
                socket.create_connection(("127.0.0.1", port_of(url)))
    with reserve(url), pytest.raises(ConfigError, match="in use"), reserve(url):
        pass
    with (
        open_address("tcp://127.0.0.1:*") as taken,
        pytest.raises(ConfigError, match="in use"),
        reserve(taken.endpoint),
    ):
        pass


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can become another user")
def test_a_port_that_is_reserved_is_closed_to_other_users() -> None:
    with open_address("tcp://127.0.0.1:*") as free:
        url = free.endpoint
    program = f"""\
import os, socket
os.setuid(65534)
for shared in (False, True):
    try:
        socket.create_server(("127.0.0.1", {port_of(url)}), reuse_port=shared)
    except OSError:
        continue
    raise SystemExit(1)
"""
    with reserve(url):
        assert subprocess.run([sys.executable, "-c", program], timeout=60).returncode == 0


def port_of(url: str) -> int:
    return int(url.rpartition(":")[2])


@pytest.mark.parametrize("reading", [True, False])
def test_last_words_are_received_after_nothing_can_be_sent(reading: bool) -> None:
    with connected() as (connection, other):
        connection.read(reading)
        connection.send(b"not read, so that the close is a reset")
        other.sendall(b"last words")
        other.close()
        connection.send(b"too late")
        assert connection.unsent == 0
        assert connection.receive() == b"last words"
        assert connection.receive() == b""


def test_lines_are_written_in_order_and_all_before_the_end() -> None:
    written: list[str] = []
    log = Log(written.append)
    for number in range(500):
        log(f"{number}")
    log.close(TIMEOUT)
    log("too late")
    assert written == [f"{number}" for number in range(500)]


def test_lines_that_do_not_fit_are_counted_and_dropped() -> None:
    written: list[str] = []
    stuck, go_on = threading.Event(), threading.Event()

    def write(line: str) -> None:
        stuck.set()
        go_on.wait()
        written.append(line)

    log = Log(write)
    log("first")
    stuck.wait()
    for number in range(5000):
        log(f"{number}")
    go_on.set()
    log.close(TIMEOUT)
    *lines, last = written
    assert lines == ["first", *map(str, range(1000))]
    assert last.startswith("4000 more lines were dropped")
