"""Connections that join no session: they make room for others, do not stay, and may make no mistake.

What is wrong about bytes, frames and messages is tried without sockets by `tests/glue/wire`, `tests/glue/hub`
and `tests/fuzzing`; the attacker sends all of it, and floods, beside honest sessions.
"""

from __future__ import annotations

from contextlib import ExitStack

from glue.hub.config import HubConfig
from glue.hub.io.channels import MAX_WITHOUT_SESSION
from glue.hub.io.server import Hub
from glue.wire.messages import ErrorCode
from tests.scripted.peer import GREETING, TIMEOUT, ScriptedPeer, framed


def test_of_connections_that_join_no_session_the_oldest_make_room() -> None:
    config = HubConfig(bind=("tcp://127.0.0.1:*",), heartbeat=60.0, timeout=600.0, farewell=0.0)
    extra = 4
    with Hub(config).in_background() as hub, ExitStack() as stack:
        connections = [
            stack.enter_context(ScriptedPeer(hub.endpoints[0]).connect())
            for _ in range(MAX_WITHOUT_SESSION + extra)
        ]
        for connection in connections[:extra]:
            connection.read_to_end()
        for connection in connections[extra:]:
            assert connection.read(64) == GREETING


def test_a_connection_that_joins_no_session_does_not_stay() -> None:
    config = HubConfig(bind=("tcp://127.0.0.1:*",), heartbeat=0.05, greeting=TIMEOUT)
    with Hub(config).in_background() as hub:
        url = hub.endpoints[0]
        with ScriptedPeer(url).connect() as silent, ScriptedPeer(url).greet() as greeted:
            object.__setattr__(hub.config, "greeting", 0.0)  # from now on it waits for nobody
            for connection in (silent, greeted):
                connection.read_to_end()


def test_a_connection_that_joins_no_session_ends_at_its_first_malformed_message() -> None:
    config = HubConfig(bind=("tcp://127.0.0.1:*",), greeting=TIMEOUT)
    with Hub(config).in_background() as hub, ScriptedPeer(hub.endpoints[0]).greet() as connection:
        connection.send_bytes(framed(b"x") * 1000)
        assert connection.read_to_end().count(ErrorCode.MALFORMED.encode()) == 1
