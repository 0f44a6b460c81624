"""Round trips without RL-Glue: plain sockets and pyzmq DEALER/ROUTER, with the bytes of one step.

One end is a separate process, like the players of an experiment.
"""

from __future__ import annotations

import socket
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import zmq

from benchmarks.measure import Rate, rate

_HEADER = b"\x95" + bytes(19)  # as long as the header of a step
_COUNT = 5000


@contextmanager
def zmq_round_trips(transport: str, size: int, reply_size: int) -> Iterator[Callable[[], Rate]]:
    """Yield a measure of round trips per second between a ROUTER here and a DEALER in another process."""
    with (
        zmq.Context() as context,
        tempfile.TemporaryDirectory() as folder,
        context.socket(zmq.ROUTER) as router,
    ):
        router.bind(f"ipc://{folder}/raw" if transport == "ipc" else "tcp://127.0.0.1:*")
        with _other_end("zmq", router.getsockopt_string(zmq.LAST_ENDPOINT), reply_size) as pid:
            route, _ = router.recv_multipart()
            body = bytes(size)

            def exchange() -> None:
                for _ in range(_COUNT):
                    router.send_multipart((route, _HEADER, body))
                    router.recv_multipart()

            yield lambda: rate(exchange, _COUNT, [pid])


@contextmanager
def socket_round_trips(transport: str, size: int, reply_size: int) -> Iterator[Callable[[], Rate]]:
    """Yield a measure of round trips per second over one plain connection, `ipc` or `tcp`."""
    with tempfile.TemporaryDirectory() as folder, _listening(transport, folder) as server:
        name = server.getsockname()
        address = name if transport == "ipc" else f"{name[0]}:{name[1]}"
        with _other_end(transport, address, reply_size, size) as pid:
            connection, _ = server.accept()
            with connection:
                _no_delay(connection)
                body = bytes(len(_HEADER) + size)
                expected = len(_HEADER) + reply_size

                def exchange() -> None:
                    for _ in range(_COUNT):
                        connection.sendall(body)
                        _receive_exactly(connection, expected)

                yield lambda: rate(exchange, _COUNT, [pid])


def _listening(transport: str, folder: str) -> socket.socket:
    if transport == "tcp":
        return socket.create_server(("127.0.0.1", 0))
    return socket.create_server(f"{folder}/raw", family=socket.AF_UNIX)


def _no_delay(connection: socket.socket) -> None:
    if connection.family != socket.AF_UNIX:
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)


@contextmanager
def _other_end(kind: str, address: str, *sizes: int) -> Iterator[int]:
    process = subprocess.Popen([sys.executable, "-m", "benchmarks.raw", kind, address, *map(str, sizes)])
    try:
        yield process.pid
    finally:
        process.terminate()
        process.wait()


def _receive_exactly(connection: socket.socket, size: int) -> None:
    while size:
        received = len(connection.recv(size))
        if not received:
            raise ConnectionError
        size -= received


def _echo_zmq(url: str, reply_size: str) -> None:
    body = bytes(int(reply_size))
    with zmq.Context() as context, context.socket(zmq.DEALER) as dealer:
        dealer.connect(url)
        dealer.send(b"here")
        while True:
            dealer.recv_multipart()
            dealer.send_multipart((_HEADER, body))


def _echo_socket(transport: str, address: str, reply_size: str, size: str) -> None:
    reply = bytes(len(_HEADER) + int(reply_size))
    with socket.socket(socket.AF_UNIX if transport == "ipc" else socket.AF_INET) as connection:
        host, _, port = address.rpartition(":")
        connection.connect(address if transport == "ipc" else (host, int(port)))
        _no_delay(connection)
        try:
            while True:
                _receive_exactly(connection, len(_HEADER) + int(size))
                connection.sendall(reply)
        except ConnectionError:
            return


if __name__ == "__main__":
    if sys.argv[1] == "zmq":
        _echo_zmq(*sys.argv[2:])
    else:
        _echo_socket(*sys.argv[1:])
