"""Connections that occupy the page's server and never show the token."""

from __future__ import annotations

import contextlib
import resource
import socket
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.experiment_runner.view.pages import Page, glue_view

_IDLE = 1_200
_SECONDS = 60.0


@pytest.fixture
def page(tmp_path: Path) -> Iterator[Page]:
    """A server that may open as many files as most systems allow by default."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (1024, hard))
    try:
        with glue_view(tmp_path) as page:
            resource.setrlimit(resource.RLIMIT_NOFILE, (hard, hard))
            yield page
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))


def connect(page: Page, source: str = "127.0.0.1") -> socket.socket:
    return socket.create_connection(("127.0.0.1", page.port), _SECONDS, source_address=(source, 0))


def is_closed(connection: socket.socket) -> bool:
    """Wait for the server; return whether it closes a connection."""
    with contextlib.suppress(ConnectionResetError):
        return connection.recv(1) == b""
    return True


def test_idle_connections_do_not_shut_the_page(page: Page) -> None:
    """Only the newest connections from each address stay open, which leaves room for the token's owner."""
    stream = page.stream("topic=runs")
    with contextlib.ExitStack() as stack:
        idle = [stack.enter_context(connect(page)) for _ in range(_IDLE)]
        assert page.ask("/").status == 200
        assert is_closed(idle[0])
        assert stream.next() == {"runs": {}}


def test_one_address_takes_no_more_than_its_share(page: Page) -> None:
    with contextlib.ExitStack() as stack:
        first = stack.enter_context(connect(page))
        many = [stack.enter_context(connect(page, "127.0.0.2")) for _ in range(_IDLE)]
        assert is_closed(many[0])
        first.sendall(f"GET / HTTP/1.1\r\nHost: 127.0.0.1:{page.port}\r\n\r\n".encode())
        assert first.recv(12) == b"HTTP/1.1 403"


@pytest.mark.parametrize("sent", [b"", b"GET / HTTP/1.1\r\nHost: 127"])
def test_a_head_that_does_not_come_ends_its_connection(page: Page, sent: bytes) -> None:
    with connect(page) as connection:
        connection.sendall(sent)
        assert is_closed(connection)
