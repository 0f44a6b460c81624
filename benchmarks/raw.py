"""Round trips without RL-Glue: pyzmq DEALER/ROUTER and plain TCP, with the bytes of one step.

One end is a process of its own, as the players of an experiment are.
"""

from __future__ import annotations

import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import zmq

__all__ = ["tcp_round_trips", "zmq_round_trips"]

_HEADER = b"\x95" + bytes(19)  # as long as the header of a step


@contextmanager
def zmq_round_trips(transport: str, size: int, reply_size: int) -> Iterator[Callable[[], float]]:
    """Give a measure of round trips per second between a ROUTER here and a DEALER elsewhere."""
    with (
        zmq.Context() as context,
        tempfile.TemporaryDirectory() as folder,
        context.socket(zmq.ROUTER) as router,
    ):
        router.bind(f"ipc://{folder}/raw" if transport == "ipc" else "tcp://127.0.0.1:*")
        with _other_end("zmq", router.getsockopt_string(zmq.LAST_ENDPOINT), reply_size):
            route, _ = router.recv_multipart()
            body = bytes(size)

            def measure(count: int = 5000) -> float:
                began = time.perf_counter()
                for _ in range(count):
                    router.send_multipart((route, _HEADER, body))
                    router.recv_multipart()
                return count / (time.perf_counter() - began)

            yield measure


@contextmanager
def tcp_round_trips(size: int, reply_size: int) -> Iterator[Callable[[], float]]:
    """Give a measure of round trips per second over one plain TCP connection."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        address = f"127.0.0.1:{server.getsockname()[1]}"
        with _other_end("tcp", address, reply_size, size):
            connection, _ = server.accept()
            with connection:
                connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                body = bytes(len(_HEADER) + size)
                expected = len(_HEADER) + reply_size

                def measure(count: int = 5000) -> float:
                    began = time.perf_counter()
                    for _ in range(count):
                        connection.sendall(body)
                        _receive_exactly(connection, expected)
                    return count / (time.perf_counter() - began)

                yield measure


@contextmanager
def _other_end(kind: str, address: str, *sizes: int) -> Iterator[None]:
    process = subprocess.Popen([sys.executable, "-m", "benchmarks.raw", kind, address, *map(str, sizes)])
    try:
        yield
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


def _echo_tcp(address: str, reply_size: str, size: str) -> None:
    host, port = address.split(":")
    reply = bytes(len(_HEADER) + int(reply_size))
    with socket.create_connection((host, int(port))) as connection:
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
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
        _echo_tcp(*sys.argv[2:])
