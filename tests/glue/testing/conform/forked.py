"""Clients to judge, forked from a process that has imported everything."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from multiprocessing.context import ForkServerProcess
from pathlib import Path
from typing import Any

from glue.protocol.messages import Role
from glue.testing.conform.hub.clients import Start, is_awake
from glue.testing.mirror import run_mirror
from tests.forked import SERVER, redirect
from tests.glue.testing.conform.wrong import run


class Forked:
    """A client: a function of the hub's address, the session and more, which returns its exit code."""

    def __init__(self, run: Callable[..., int], *arguments: Any) -> None:
        self._folder = tempfile.TemporaryDirectory()
        self._printed = Path(self._folder.name) / "printed"
        self._process: ForkServerProcess = SERVER.Process(
            target=_main, args=(self._printed, run, arguments), daemon=True
        )
        self._process.start()

    def wait(self, seconds: float) -> int | None:
        self._process.join(seconds)
        return self._process.exitcode

    def kill(self) -> None:
        self._process.kill()
        self._process.join()
        self._folder.cleanup()

    def output(self) -> str:
        return self._printed.read_text(errors="replace") if self._printed.exists() else ""

    def awake(self) -> bool | None:
        return is_awake(self._process.pid)


def _main(printed: Path, run: Callable[..., int], arguments: tuple[Any, ...]) -> None:
    for descriptor in (1, 2):
        redirect(descriptor, printed)
    raise SystemExit(run(*arguments))


def wrong(role: Role, fault: str) -> Start:
    """Return what starts a client with a fault, or with none."""
    return lambda hub, session: Forked(run, str(role), hub, session, fault)


def mirror(role: Role, libzmq: bool) -> Start:
    """Return what starts our own mirror."""
    return lambda hub, session: Forked(_mirror, role, hub, session, libzmq)


def _mirror(role: Role, hub: str, session: str, libzmq: bool) -> int:
    context = None
    if libzmq:
        from glue.client.libzmq import Context

        context = Context()
    return run_mirror(role, hub, session, context)
