"""A hub for programs in other languages, and our own programs that play with them."""

from __future__ import annotations

import os
import re
import subprocess
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import IO, Final

from env_server.toys import SkeletonEnvironment
from glue.engine.local import local
from tests.clients.random_agent import RandomAgent
from tests.players import outcomes

SECONDS: Final = 120.0
"""Timeout in seconds: longer than anything here takes, unless it hangs."""

_EPISODE: Final = re.compile(r"episode (\d+): return (\S+), (\d+) steps")

Episode = tuple[float, int]
"""Return and steps."""


@contextmanager
def program(
    command: Sequence[str], url: str, session: str = "default", **variables: str
) -> Iterator[subprocess.Popen[str]]:
    """Run a program at a hub, with environment variables; kill it at the end if it still runs."""
    place = {"GLUE_HUB": url, "GLUE_SESSION": session, **variables}
    with subprocess.Popen(
        command,
        env={**os.environ, **place},
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
    ) as process:
        try:
            yield process
        finally:
            process.kill()


def walked(episodes: int, seed: int) -> list[Episode]:
    """Return the episodes that the example experiment prints, played by our players."""
    glue = local(RandomAgent(), SkeletonEnvironment())
    glue.rl_init(seed)
    return outcomes(glue, episodes, 1000)


def read_episodes(output: IO[str]) -> list[Episode]:
    """Return the episodes that an experiment has printed."""
    return [
        (float(match[2]), int(match[3])) for line in output if (match := _EPISODE.match(line)) is not None
    ]
