"""A connection reads and writes what it can, and notices the end."""

from __future__ import annotations

import socket
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from glue.hub.connection import Connection
from glue.hub.loop import Loop


@contextmanager
def connected() -> Iterator[tuple[Connection, socket.socket]]:
    """A connection, and the other side of it."""
    loop = Loop(1.0, print)
    with socket.create_server(("127.0.0.1", 0)) as listening:
        other = socket.create_connection(listening.getsockname())
        accepted, _ = listening.accept()
    connection = Connection(loop, accepted, "other", 1.0)
    with other:
        yield connection, other
    connection.close()
    loop.close()


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
