"""Poses as the environment, as the experiment, and as the agents of other sessions."""

from __future__ import annotations

import os
import sys
import threading
from collections.abc import Callable
from functools import partial

from env_server.toys import SkeletonEnvironment
from glue import serve_agent, serve_environment
from glue.client.experiment import connect
from glue.errors import GlueError
from tests.jails.hostile.honest import Honest

_SECONDS = 5.0


def poses(hub: str, own: str) -> dict[str, Callable[[], object]]:
    """Return the attempts, by name."""
    others = [own.replace(part, other) for part in own.split("/") for other in ("honest", "0", "1")]
    tried: dict[str, Callable[[], object]] = {
        "environment": lambda: serve_environment(SkeletonEnvironment(), hub, own, wait=_SECONDS),
        "experiment": lambda: connect(hub, own, wait=_SECONDS),
    }
    for session in ("default", *others):
        if session != own:
            tried[f"agent of {session!r}"] = partial(serve_agent, Honest(), hub, session, wait=_SECONDS)
    return tried


def attempt(what: str, pose: Callable[[], object]) -> None:
    """Try one pose, and print its outcome."""
    try:
        pose()
        came = "believed"
    except GlueError as error:
        came = f"{type(error).__name__}: {error}"
    # In one write: `print` would let another thread write between a line and its newline.
    sys.stdout.write(f"{what}: {came}\n")


if __name__ == "__main__":
    threads = [
        threading.Thread(target=attempt, args=pose, daemon=True)
        for pose in poses(os.environ["GLUE_HUB"], os.environ["GLUE_SESSION"]).items()
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(2 * _SECONDS)
    sys.exit(5)
