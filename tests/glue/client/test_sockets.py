"""A peer's end on plain sockets, against libzmq's ROUTER, an independent implementation."""

from __future__ import annotations

import socket
import threading
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import pytest

from glue.client.sockets import SocketTransport
from glue.wire.messages import MAX_BODY, Kind, Message
from tests.scripted.hub import ScriptedHub

SECONDS = 10.0
MAX_FRAME = 2**25
HEARTBEAT = Message(Kind.HEARTBEAT, "", 0)


@pytest.fixture(params=["tcp", "ipc"])
def hub(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[ScriptedHub]:
    with ScriptedHub("tcp://127.0.0.1:*" if request.param == "tcp" else f"ipc://{tmp_path}/hub") as hub:
        yield hub


def connect(url: str) -> SocketTransport:
    """Return a connected transport."""
    transport = SocketTransport(url, SECONDS, MAX_FRAME)
    while not transport.connected:
        assert transport.receive_message(MAX_BODY) is None
    return transport


def introduce(hub: ScriptedHub, transport: SocketTransport) -> None:
    """Let the hub receive a message of the transport, so that the hub knows where to send."""
    transport.send_message(HEARTBEAT)
    assert hub.next() == HEARTBEAT


def test_messages_go_both_ways(hub: ScriptedHub) -> None:
    transport = connect(hub.url)
    for text in (b"", bytes(255), bytes(10**6)):
        message = Message(Kind.AGENT_MESSAGE, "s", 1, (), text)
        assert transport.send_message(message)
        assert hub.next() == message
        hub.send(message)
        assert transport.receive_message(MAX_BODY) == message
    transport.close()


def test_what_both_send_at_once_blocks_neither(hub: ScriptedHub) -> None:
    transport = connect(hub.url)
    introduce(hub, transport)
    message = Message(Kind.AGENT_MESSAGE, "s", 1, (), bytes(2**23))
    hub.send(*[message] * 4)  # libzmq sends them from a thread of its own
    for _ in range(4):
        assert transport.send_message(message)
        hub.next()
    for _ in range(4):
        assert transport.receive_message(MAX_BODY) == message
    transport.close()


def test_what_is_sent_last_arrives_although_much_is_unread(hub: ScriptedHub) -> None:
    transport = connect(hub.url)
    introduce(hub, transport)
    hub.send(*[Message(Kind.AGENT_MESSAGE, "s", 1, (), bytes(1000))] * 100)
    goodbye = Message(Kind.GOODBYE, "s", 0, ("over",))
    transport.send_message(goodbye)
    closing = threading.Thread(target=transport.close)
    closing.start()
    assert hub.next() == goodbye
    closing.join()


def test_what_is_not_a_hub_is_left_and_tried_again(tmp_path: Path) -> None:
    with socket.create_server(str(tmp_path / "hub"), family=socket.AF_UNIX) as server:
        transport = SocketTransport(f"ipc://{tmp_path}/hub", SECONDS, MAX_FRAME)
        transport.wait_at_most(0.01)
        for _ in range(2):
            server.settimeout(0.001)
            while True:
                assert transport.receive_message(MAX_BODY) is None
                try:
                    connected, _ = server.accept()
                    break
                except TimeoutError:
                    continue
            connected.sendall(b"HTTP/1.1 400 Bad Request\r\n" + bytes(100))
            connected.settimeout(0.001)
            with connected, suppress(ConnectionResetError):
                while True:
                    assert transport.receive_message(MAX_BODY) is None
                    with suppress(TimeoutError):
                        if not connected.recv(1000):
                            break
            assert not transport.connected
        transport.close()
