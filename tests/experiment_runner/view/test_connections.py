"""Connections that occupy the page's server and never show the token."""

from __future__ import annotations

import contextlib
import socket
from pathlib import Path

import pytest

from experiment_runner.view.app import page
from experiment_runner.view.guard import Address
from experiment_runner.view.server import Connection
from experiment_runner.view.stream import Pulse
from tests.experiment_runner.view.pages import glue_view, in_thread

_SECONDS = 60.0
_MANY = 1_200


class Patient(Connection):
    """A server of few connections, which waits for as long as a test may take."""

    most, share, head_seconds = 12, 6, 600.0


class Hasty(Connection):
    head_seconds = 0.05


def served(folder: Path, connection: type[Connection]) -> contextlib.AbstractContextManager[int]:
    """Serve the page in another thread; yield the port."""
    return in_thread(
        lambda port: page([folder], Address(port), "token", Pulse()),
        http=connection,
        timeout_graceful_shutdown=1,
    )


def connect(port: int, source: str = "127.0.0.1") -> socket.socket:
    return socket.create_connection(("127.0.0.1", port), _SECONDS, source_address=(source, 0))


def is_closed(connection: socket.socket) -> bool:
    """Wait for the server; return whether it closes a connection."""
    with contextlib.suppress(ConnectionResetError):
        return connection.recv(1) == b""
    return True


def status(connection: socket.socket, port: int) -> bytes:
    connection.sendall(f"GET / HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\n\r\n".encode())
    return connection.recv(12)[-3:]


def test_idle_connections_give_way_to_newer_ones(tmp_path: Path) -> None:
    with served(tmp_path, Patient) as port, contextlib.ExitStack() as stack:
        idle = [stack.enter_context(connect(port)) for _ in range(20)]
        assert is_closed(idle[0])
        assert status(stack.enter_context(connect(port)), port) == b"403"


def test_one_address_takes_no_more_than_its_share(tmp_path: Path) -> None:
    with served(tmp_path, Patient) as port, contextlib.ExitStack() as stack:
        first = stack.enter_context(connect(port))
        many = [stack.enter_context(connect(port, "127.0.0.2")) for _ in range(20)]
        assert is_closed(many[0])
        assert status(first, port) == b"403"


@pytest.mark.parametrize("sent", [b"", b"GET / HTTP/1.1\r\nHost: 127"])
def test_a_head_that_does_not_come_ends_its_connection(tmp_path: Path, sent: bytes) -> None:
    with served(tmp_path, Hasty) as port, connect(port) as connection:
        connection.sendall(sent)
        assert is_closed(connection)


@pytest.mark.stage("page")
def test_idle_connections_do_not_shut_the_page(tmp_path: Path) -> None:
    """Only the newest connections from each address stay open, which leaves room for the token's owner."""
    with glue_view(tmp_path) as page, contextlib.ExitStack() as stack:
        stream = page.stream("topic=runs")
        for _ in range(_MANY):
            stack.enter_context(connect(page.port))
        assert page.ask("/").status == 200
        assert stream.next() == {"runs": {}}
