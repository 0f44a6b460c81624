"""Clients to judge, forked from a process that has imported everything: each starts in no time."""

from __future__ import annotations

import multiprocessing
import os
import tempfile
from collections.abc import Callable
from multiprocessing.context import ForkServerProcess
from pathlib import Path
from typing import Any

from glue.protocol.messages import Role
from glue.testing.conform.hub.clients import Start, is_awake
from glue.testing.mirror import run_mirror
from tests.glue.testing.conform.wrong import run

_SERVER = multiprocessing.get_context("forkserver")
_SERVER.set_forkserver_preload(
    ["tests.glue.testing.conform.forked", "tests.glue.testing.conform.wrong_experiment"]
)


class Forked:
    """A client: a function of the hub's address, the session and more, which returns its exit code."""

    def __init__(self, run: Callable[..., int], *arguments: Any) -> None:
        self._folder = tempfile.TemporaryDirectory()
        self._printed = Path(self._folder.name) / "printed"
        self._process: ForkServerProcess = _SERVER.Process(
            target=_main, args=(str(self._printed), run, arguments), daemon=True
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


def _main(printed: str, run: Callable[..., int], arguments: tuple[Any, ...]) -> None:
    output = os.open(printed, os.O_CREAT | os.O_WRONLY | os.O_APPEND)
    os.dup2(output, 1)
    os.dup2(output, 2)
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
