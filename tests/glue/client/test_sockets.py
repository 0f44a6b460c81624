"""A peer's end on plain sockets, against libzmq's ROUTER, an independent implementation."""

from __future__ import annotations

import socket
import threading
from collections.abc import Iterator
from pathlib import Path

import msgpack
import pytest

from glue.client import sockets
from glue.client.sockets import SocketTransport
from glue.wire.codec import UnknownKind
from glue.wire.limits import MAX_BODY
from glue.wire.messages import Kind, Message
from tests.scripted.hub import ScriptedHub
from tests.system.proxy import Proxy

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


class Clock:
    """A clock set by hand."""

    now = 0.0

    def monotonic(self) -> float:
        return self.now


def test_answers_to_steps_received_together_leave_in_order_and_in_groups(
    hub: ScriptedHub, monkeypatch: pytest.MonkeyPatch
) -> None:
    transport = connect(hub.url)
    introduce(hub, transport)
    sizes, send, clock = [], SocketTransport._send, Clock()

    def counted(transport: SocketTransport, data: bytes) -> bool:
        sizes.append(data.count(b"\x95\x0d"))  # headers of ENV_STEP
        return send(transport, data)

    with monkeypatch.context() as patched:
        patched.setattr(sockets, "clock", clock)
        patched.setattr(SocketTransport, "_send", counted)
        sessions = [str(number) for number in range(100)]
        for seq in (1, 2):
            hub.send(*(Message(Kind.ENV_STEP, session, seq, (), bytes(16)) for session in sessions))
            answers = [Message(Kind.ENV_STEP, session, seq, (1.5, True), bytes(16)) for session in sessions]
            for answer in answers:
                call = transport.receive_message(MAX_BODY)
                assert call is not None
                assert call.session == answer.session
                clock.now += 50e-6
                assert transport.send_message(answer)
            assert [hub.next() for _ in sessions] == answers
    assert sum(sizes) == 2 * len(sessions)
    assert len(sizes) <= len(sessions), sizes
    transport.close()


def test_what_follows_an_unknown_kind_is_read(hub: ScriptedHub) -> None:
    transport = connect(hub.url)
    introduce(hub, transport)
    hub.send_frames(msgpack.packb([999, "s", 7]), b"a body")
    hub.send(HEARTBEAT)
    with pytest.raises(UnknownKind) as raised:
        transport.receive_message(MAX_BODY)
    assert (raised.value.session, raised.value.seq) == ("s", 7)
    assert transport.receive_message(MAX_BODY) == HEARTBEAT
    transport.close()


def test_nothing_in_time_is_none(hub: ScriptedHub) -> None:
    transport = connect(hub.url)
    transport.wait_at_most(0.01)
    assert transport.receive_message(MAX_BODY) is None
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


@pytest.mark.parametrize("piece", [1, 7])
def test_a_router_whose_bytes_arrive_in_pieces_is_understood(piece: int) -> None:
    with ScriptedHub() as hub, Proxy(int(hub.url.rpartition(":")[2]), piece=piece).in_background() as proxy:
        transport = connect(proxy.url)
        message = Message(Kind.AGENT_MESSAGE, "s", 1, (), bytes(300))
        introduce(hub, transport)
        hub.send(message)
        assert transport.receive_message(MAX_BODY) == message
        transport.close()


def test_a_broken_connection_is_made_again_and_counted(tmp_path: Path) -> None:
    with socket.create_server(str(tmp_path / "hub"), family=socket.AF_UNIX) as server:
        transport = SocketTransport(f"ipc://{tmp_path}/hub", SECONDS, MAX_FRAME)
        for number in (1, 2, 3):
            thread = threading.Thread(target=greet_and_close, args=(server,))
            thread.start()
            while transport.connections < number:
                transport.receive_message(MAX_BODY)
            while transport.connected:
                transport.receive_message(MAX_BODY)
            thread.join()
        transport.close()


def greet_and_close(server: socket.socket) -> None:
    """Act as a ROUTER until the handshake is complete, then close."""
    from glue.wire import zmtp

    connected, _ = server.accept()
    with connected:
        connected.sendall(zmtp.GREETING)
        decoder = zmtp.Decoder(zmtp.ROUTER, 100)
        while not decoder.ready:
            decoder.receive_data(connected.recv(100))
            while event := decoder.next_event():
                assert isinstance(event, bytes)
                connected.sendall(event)


def test_what_is_not_a_hub_is_named_and_tried_again(tmp_path: Path) -> None:
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
            while transport.problem is None:
                transport.receive_message(MAX_BODY)
            assert "ZeroMQ" in transport.problem
            transport.problem = None
            connected.close()
        transport.close()
