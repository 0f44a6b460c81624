"""A small hub on libzmq's ROUTER: the sessions are ours, and everything on the wire is libzmq's."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final

from glue.hub.config import HubConfig
from glue.hub.sessions import Switchboard
from glue.wire.messages import Message, Role
from tests.scripted.hub import ScriptedHub

_CONFIG: Final = HubConfig(heartbeat=0.1, timeout=60.0, greeting=60.0)


class _Route:
    """A connection, by the identity that the ROUTER gave it."""

    def __init__(self, hub: ScriptedHub, identity: bytes) -> None:
        self._hub = hub
        self._identity = identity

    def deliver(self, message: Message) -> bool:
        return self._hub.deliver(self._identity, message)

    def admits(self, role: Role, session: str) -> bool:
        return True


@contextmanager
def router_hub() -> Iterator[str]:
    """Serve in a thread; yield the address."""
    ending = threading.Event()
    with ScriptedHub() as hub:
        thread = threading.Thread(target=_serve, args=(hub, ending))
        thread.start()
        try:
            yield hub.url
        finally:
            ending.set()
            thread.join()


def _serve(hub: ScriptedHub, ending: threading.Event) -> None:
    board = Switchboard(_CONFIG, lambda line: None)
    routes: dict[bytes, _Route] = {}
    tick_at = time.monotonic()
    while not ending.is_set():
        if hub.can_receive(_CONFIG.heartbeat):
            message = hub.next()
            route = routes.setdefault(hub.route, _Route(hub, hub.route))
            board.receive(route, message, time.monotonic())
        if time.monotonic() >= tick_at:
            board.tick(time.monotonic())
            tick_at = time.monotonic() + _CONFIG.heartbeat
    board.close("over")
