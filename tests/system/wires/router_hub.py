"""A small hub on libzmq's ROUTER, to play with: sessions are ours, all that is on the wire is libzmq's."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final

import zmq

from glue.core.config import HubConfig
from glue.core.sessions import Switchboard
from glue.protocol.messages import Message, Role
from glue.protocol.wire import FROM_HUB, TO_HUB, decode, encode

__all__ = ["router_hub"]

_CONFIG: Final = HubConfig(heartbeat=0.1, timeout=60.0)


class _Route:
    """A connection, by the identity that the ROUTER gave it."""

    def __init__(self, router: zmq.Socket[bytes], identity: bytes) -> None:
        self._router = router
        self._identity = identity

    def deliver(self, message: Message) -> bool:
        try:
            self._router.send_multipart([self._identity, *encode(message, FROM_HUB)], zmq.DONTWAIT)
        except zmq.ZMQError:  # its connection has ended
            return False
        return True

    def admits(self, role: Role, session: str) -> bool:
        return True


@contextmanager
def router_hub() -> Iterator[str]:
    """Serve in a thread; give the address."""
    ending = threading.Event()
    with zmq.Context() as context, context.socket(zmq.ROUTER) as router:
        router.setsockopt(zmq.LINGER, 1000)
        router.setsockopt(zmq.ROUTER_MANDATORY, 1)
        port = router.bind_to_random_port("tcp://127.0.0.1")
        thread = threading.Thread(target=_serve, args=(router, ending))
        thread.start()
        try:
            yield f"tcp://127.0.0.1:{port}"
        finally:
            ending.set()
            thread.join()


def _serve(router: zmq.Socket[bytes], ending: threading.Event) -> None:
    board = Switchboard(_CONFIG, lambda line: None)
    routes: dict[bytes, _Route] = {}
    tick_at = time.monotonic()
    while not ending.is_set():
        if router.poll(int(_CONFIG.heartbeat * 1000)):
            identity, *frames = router.recv_multipart()
            route = routes.setdefault(identity, _Route(router, identity))
            board.receive(route, decode(frames, TO_HUB), time.monotonic())
        if time.monotonic() >= tick_at:
            board.tick(time.monotonic())
            tick_at = time.monotonic() + _CONFIG.heartbeat
    board.close("over")
