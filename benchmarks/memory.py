"""Memory of hub and players over ten million steps, in half an hour: anything kept for a step would show."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Final

from benchmarks.measure import Table
from benchmarks.players import SIZES, serving
from glue.client.experiment import connect_over
from glue.hub.config import HubConfig
from glue.hub.io.inside import InsideTransport
from glue.hub.io.server import Hub

_STEPS: Final = 10_000_000
_PARTS: Final = 10
_EPISODE: Final = 1000
_SIZE: Final = list(SIZES)[1]


def run() -> list[Table]:
    """Measure the memory of three processes."""
    rows = []
    with Hub(HubConfig(bind=("tcp://127.0.0.1:*",))).in_background() as hub:
        url = hub.endpoints[0]
        with (
            serving("environment", _SIZE, url) as environment,
            serving("agent", _SIZE, url) as agent,
            connect_over(InsideTransport(hub), "0") as glue,
        ):
            glue.rl_init()
            for part in range(_PARTS):
                for _ in range(_STEPS // _PARTS // _EPISODE):
                    glue.rl_episode(_EPISODE)
                memory = [_resident(pid) for pid in (os.getpid(), environment, agent)]
                print(*memory, file=sys.stderr, flush=True)
                rows.append((f"{(part + 1) * _STEPS // _PARTS:,}", *(f"{kib:,}" for kib in memory)))
    return [
        Table(
            "Memory over ten million steps",
            "Resident, in KiB, of the hub with the experiment, the environment and the agent; over tcp, in "
            f"episodes of {_EPISODE:,} steps.",
            ("steps", "hub", "environment", "agent"),
            rows,
        )
    ]


def _resident(pid: int) -> int:
    return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * os.sysconf("SC_PAGESIZE") // 1024
