"""Poses as the environment, as the experiment, and as the agents of other sessions."""

from __future__ import annotations

import os
import sys
import threading

from honest import Honest

from glue import serve_agent, serve_environment
from glue.client.experiment import connect
from glue.errors import GlueError

_SECONDS = 5.0


class Mole:
    """An environment that would pay whatever it likes."""

    def env_init(self) -> str:
        return ""

    def __getattr__(self, name: str) -> object:
        raise AssertionError(f"{name} was called: the pose was believed")


def poses(hub: str, own: str) -> dict[str, object]:
    """Return what is tried, by name."""
    others = [own.replace(part, other) for part in own.split("/") for other in ("honest", "0", "1")]
    tried: dict[str, object] = {
        "environment": lambda: serve_environment(Mole(), hub, own, wait=_SECONDS),  # type: ignore[arg-type]
        "experiment": lambda: connect(hub, own, wait=_SECONDS).__enter__(),
    }
    for session in ("default", *others):
        if session != own:
            tried[f"agent of {session!r}"] = lambda name=session: serve_agent(
                Honest(), hub, name, wait=_SECONDS
            )
    return tried


def attempt(what: str, pose: object) -> None:
    """Try one pose, and print what came of it."""
    try:
        pose()  # type: ignore[operator]
        print(f"{what}: believed")
    except GlueError as error:
        print(f"{what}: {type(error).__name__}: {error}")


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
