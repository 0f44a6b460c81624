"""Clients to judge, forked from a process that has imported everything."""

from __future__ import annotations

import time
from typing import cast

from glue import AgentLike, EnvironmentLike, serve_agent, serve_environment
from glue.conform.clients.mirror import run_mirror
from glue.conform.clients.process import Start, is_awake
from glue.errors import GlueError
from glue.wire.messages import Role
from tests.forked import Recorded
from tests.glue.conform.wrong import run

ENDS = [("tcp", False), ("ipc", True), ("ipc", False), ("tcp", True)]
"""Transports, each with plain sockets or with libzmq."""


WAIT = 60.0
"""Seconds to wait for a message that will come; generous, as machines are busy."""

QUIET = 0.02
"""Seconds without a message after which a client that is right is known to be silent."""


class Judged(Recorded):
    """A client to judge: a function in a process of its own."""

    def awake(self) -> bool | None:
        return is_awake(self.pid)


def wrong(role: Role, fault: str) -> Start:
    """Return a function that starts a client with a fault, or with none."""
    return lambda hub, session: Judged(run, str(role), hub, session, fault)


def mirror(role: Role, libzmq: bool) -> Start:
    """Return a function that starts our own mirror."""
    return lambda hub, session: Judged(_mirror, role, hub, session, libzmq)


def slow_to_close(role: Role) -> Start:
    """Return a function that starts our own mirror over libzmq, whose socket closes late after GOODBYE."""
    return lambda hub, session: Judged(_slow_to_close, role, hub, session)


def served(player: AgentLike | EnvironmentLike, name: str = "") -> Start:
    """Return a function that starts one of our players other than the mirror."""
    return lambda hub, session: Judged(_serve, player, name or None, hub, session)


def _serve(player: AgentLike | EnvironmentLike, name: str | None, hub: str, session: str) -> int:
    try:
        if hasattr(player, "agent_start"):
            print(serve_agent(cast(AgentLike, player), hub, session, name=name))
        else:
            print(serve_environment(player, hub, session, name=name))
    except GlueError as error:
        print(error)
        return 1
    return 0


def _mirror(role: Role, hub: str, session: str, libzmq: bool) -> int:
    context = None
    if libzmq:
        from glue.client.libzmq import Context

        context = Context()
    return run_mirror(role, hub, session, context)


def _slow_to_close(role: Role, hub: str, session: str) -> int:
    import zmq

    class SlowSocket(zmq.Socket[bytes]):
        def close(self, linger: int | None = None) -> None:
            time.sleep(0.2)  # libzmq reconnects within 0.1 s
            super().close(linger)

    class SlowContext(zmq.Context[zmq.Socket[bytes]]):
        _socket_class = SlowSocket

    return run_mirror(role, hub, session, SlowContext())
