"""Whoever looks for a moment receives what arrives in it, and gives up after it."""

from __future__ import annotations

import socket
from threading import Thread

import pytest

from glue.sockets.looking import receive_soon

ENDLESS = 60.0


def test_what_arrives_while_looking_is_received() -> None:
    ours, theirs = socket.socketpair()
    with ours, theirs:
        assert receive_soon(ours, 10, 0.0) is None
        sender = Thread(target=theirs.send, args=(b"here",))
        sender.start()
        assert receive_soon(ours, 10, ENDLESS) == b"here"
        sender.join()


def test_the_end_of_the_connection_is_seen() -> None:
    ours, theirs = socket.socketpair()
    with ours:
        theirs.close()
        assert receive_soon(ours, 10, ENDLESS) == b""
    ours, theirs = socket.socketpair()
    with ours:
        ours.send(b"unread")
        theirs.close()
        with pytest.raises(OSError, match="reset"):
            receive_soon(ours, 10, ENDLESS)
