"""A peer's end on plain sockets, against libzmq's ROUTER, which knows nothing of it."""

from __future__ import annotations

import socket
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest
import zmq

from glue.client.sockets import SocketTransport
from glue.protocol.messages import Kind
from glue.protocol.steps import step_formats

SECONDS = 10.0
MAX_FRAME = 2**25


@pytest.fixture(params=["tcp", "ipc"])
def router(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[zmq.Socket[bytes]]:
    """A ROUTER of libzmq that listens."""
    with zmq.Context() as context, context.socket(zmq.ROUTER) as router:
        router.setsockopt(zmq.LINGER, 0)
        router.setsockopt(zmq.RCVTIMEO, int(SECONDS * 1000))
        router.bind("tcp://127.0.0.1:*" if request.param == "tcp" else f"ipc://{tmp_path}/hub")
        yield router


def connect(url: str) -> SocketTransport:
    """Return a transport that has connected."""
    transport = SocketTransport(url, SECONDS, MAX_FRAME)
    while not transport.connected:
        assert transport.receive() is None
    return transport


def address(router: zmq.Socket[bytes]) -> str:
    return router.getsockopt_string(zmq.LAST_ENDPOINT)


def test_messages_go_both_ways(router: zmq.Socket[bytes]) -> None:
    transport = connect(address(router))
    for frames in ([b"header"], [b"header", b""], [b"h", bytes(255)], [b"h" * 300, bytes(10**6)]):
        assert transport.send(frames)
        identity, *received = router.recv_multipart()
        assert received == frames
        router.send_multipart([identity, *frames])
        assert transport.receive() == frames
    transport.close()


def test_a_step_is_recognised_by_its_bytes_and_everything_else_is_left_to_receive(
    router: zmq.Socket[bytes],
) -> None:
    transport = connect(address(router))
    request, reply = step_formats(Kind.ENV_STEP, "default")
    action = bytes(16)
    transport.send([b"here"])
    identity = router.recv_multipart()[0]
    router.send_multipart([identity, b"\x93\x0d\xa7default\x07", action])
    steps = transport.receive_steps(request, 5, MAX_FRAME)
    assert next(steps) == (7, (), action)
    assert transport.send_data(reply.head(7, (1.5, True), len(action)), action)
    header = b"\x95\x0d\xa7default\x07\xcb\x3f\xf8" + bytes(6) + b"\xc3"
    assert router.recv_multipart() == [identity, header, action]
    repeated = [b"\x93\x0d\xa7default\x07", action]
    router.send_multipart([identity, *repeated])
    assert next(steps, None) is None
    assert transport.receive() == repeated
    long = [b"\x93\x0d\xa7default\x09", action]
    router.send_multipart([identity, *long])
    assert next(transport.receive_steps(request, 7, len(action)), None) is None
    assert transport.receive() == long
    transport.close()


def test_nothing_in_time_is_none_and_waited_for_once(router: zmq.Socket[bytes]) -> None:
    transport = connect(address(router))
    transport.wait_at_most(0.01)
    request, _ = step_formats(Kind.ENV_STEP, "default")
    assert transport.receive() is None
    assert next(transport.receive_steps(request, 1, MAX_FRAME), None) is None
    transport.wait_at_most(1000 * SECONDS)
    assert transport.receive() is None
    transport.close()


def test_what_both_send_at_once_blocks_neither(router: zmq.Socket[bytes]) -> None:
    transport = connect(address(router))
    transport.send([b"here"])
    identity = router.recv_multipart()[0]
    body = bytes(2**23)
    for _ in range(4):
        router.send_multipart([identity, b"header", body])  # libzmq sends it from a thread of its own
    for _ in range(4):
        assert transport.send([b"header", body])
        router.recv_multipart()
    for _ in range(4):
        assert transport.receive() == [b"header", body]
    transport.close()


def test_what_is_sent_last_arrives_although_much_is_unread(router: zmq.Socket[bytes]) -> None:
    transport = connect(address(router))
    transport.send([b"here"])
    identity = router.recv_multipart()[0]
    for _ in range(100):
        router.send_multipart([identity, bytes(1000)])
    transport.send([b"goodbye"])
    closing = threading.Thread(target=transport.close)
    closing.start()
    assert router.recv_multipart()[1:] == [b"goodbye"]
    closing.join()


@pytest.mark.parametrize("chunk", [1, 7])
def test_a_router_whose_bytes_arrive_in_pieces_is_understood(router: zmq.Socket[bytes], chunk: int) -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        thread = threading.Thread(target=relay, args=(server, address(router), chunk))
        thread.start()
        transport = connect(f"tcp://127.0.0.1:{server.getsockname()[1]}")
        transport.send([b"header", bytes(300)])
        identity, *frames = router.recv_multipart()
        router.send_multipart([identity, *frames])
        assert transport.receive() == [b"header", bytes(300)]
        transport.close()
        thread.join()


def relay(server: socket.socket, url: str, chunk: int) -> None:
    """Pass one connection on, what the hub sends in pieces."""
    near, _ = server.accept()
    scheme, _, rest = url.partition("://")
    far = socket.socket(socket.AF_UNIX if scheme == "ipc" else socket.AF_INET)
    host, _, port = rest.rpartition(":")
    far.connect(rest if scheme == "ipc" else (host, int(port)))
    near.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)

    def upstream() -> None:
        while data := near.recv(65536):
            far.sendall(data)
        far.shutdown(socket.SHUT_WR)

    thread = threading.Thread(target=upstream)
    thread.start()
    try:
        while data := far.recv(chunk):
            near.sendall(data)
    except OSError:
        pass  # the peer has gone
    thread.join()
    near.close()
    far.close()


def test_a_broken_connection_is_made_again_and_counted(tmp_path: Path) -> None:
    with socket.create_server(str(tmp_path / "hub"), family=socket.AF_UNIX) as server:
        transport = SocketTransport(f"ipc://{tmp_path}/hub", SECONDS, MAX_FRAME)
        for number in (1, 2, 3):
            thread = threading.Thread(target=greet_and_close, args=(server,))
            thread.start()
            while transport.connections < number:
                transport.receive()
            while transport.connected:
                transport.receive()
            thread.join()
        transport.close()


def greet_and_close(server: socket.socket) -> None:
    """Be a ROUTER until the handshake is complete."""
    from glue.protocol import zmtp

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
                assert transport.receive() is None
                try:
                    connected, _ = server.accept()
                    break
                except TimeoutError:
                    continue
            connected.sendall(b"HTTP/1.1 400 Bad Request\r\n" + bytes(100))
            while transport.problem is None:
                transport.receive()
            assert "ZeroMQ" in transport.problem
            transport.problem = None
            connected.close()
        transport.close()
