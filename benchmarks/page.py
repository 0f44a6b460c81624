"""docs/performance.md: a head, then the measurements of each part, and notes."""

from __future__ import annotations

import os
import platform
import re
import sysconfig
import time
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Final

import msgpack
import numba
import numpy as np
import zmq

from benchmarks.measure import REPEATS, Table

ORDER: Final = (
    "hub",
    "sessions",
    "notes",
    "clients",
    "memory",
    "attacks",
    "legacy",
    "experiment",
    "metrics",
    "view",
    "mario",
    "agents",
    "competition",
    "realtime",
    "season",
)
"""The sections of the page, in this order: the notes, and parts of the benchmarks by their names."""

FILE: Final = Path(__file__).parent.parent / "docs" / "performance.md"
_IMAGES: Final = FILE.parent / "images"
NOTES: Final = Path(__file__).parent / "notes.md"
_MARK: Final = re.compile(r"^<!-- (\w+) -->\n", re.MULTILINE)


def beside_other_work(measure: Callable[[], list[Table]]) -> tuple[list[Table], float]:
    """Return the measurements, and the share of the processors' time that other processes had meanwhile."""
    began, busy, own = time.monotonic(), _busy_seconds(), sum(os.times()[:4])
    tables = measure()
    took, cpus = time.monotonic() - began, os.cpu_count() or 1
    others = _busy_seconds() - busy - (sum(os.times()[:4]) - own)
    return tables, min(max(others / took / cpus, 0.0), 1.0)


def section(name: str, tables: Iterable[Table], others: float) -> str:
    """Return the section of a part, which states the share of other work during its measurement."""
    source = (
        f"Measured by `python -m benchmarks {name}`; other work had {100 * others:.0f} % of the processors."
    )
    return "\n".join(table.text(source) for table in tables) + "\n"


def draw(tables: Iterable[Table]) -> None:
    """Draw the pictures of these tables."""
    for table in tables:
        if table.picture is not None:
            table.picture.draw(_IMAGES / table.picture.file)


def merged(page: str, sections: Mapping[str, str]) -> str:
    """Return `page` with `sections` in place of its sections of the same names.

    Sections measured on another machine, or with other versions, are dropped.
    """
    before, kept = sections_of(page)
    there = {**(kept if before == head() else {}), **sections, "notes": NOTES.read_text("utf-8") + "\n"}
    return head() + "".join(f"<!-- {name} -->\n{there[name]}" for name in ORDER if name in there)


def sections_of(page: str) -> tuple[str, dict[str, str]]:
    """Return the head of a page, and its sections by their names."""
    before, *parts = _MARK.split(page)
    return before, dict(zip(parts[::2], parts[1::2], strict=True))


def head() -> str:
    """Return the beginning of the page: the machine, and how to read the numbers."""
    return (
        "# Performance\n\n"
        "Written by `make bench`; repeat it on your own machine. `python -m benchmarks --write NAME` "
        f"measures one part anew. Each number is the median of at least {REPEATS} repeats, unless it says "
        "otherwise, those of one table taken in turn. Whatever else a machine does moves numbers more than "
        "their ratios within a table, so ratios come first; tables of different commands do not compare. "
        "Each table says how much of the processors other work had meanwhile: up to 3 % the machine was "
        "quiet. The fastest way to have a program of your own as the agent is an environment inside the "
        "experiment's process, `glue-experiment --inside env`: one round trip a step instead of two.\n\n"
        f"Machine: {_processor()}, {os.cpu_count()} cores, {platform.system()} {platform.machine()}; "
        f"Python {platform.python_version()}, {_configured()}, pyzmq {zmq.__version__} (libzmq "
        f"{zmq.zmq_version()}), msgpack {'.'.join(map(str, msgpack.version))}, NumPy {np.__version__}, "
        f"numba {numba.__version__}. [Gymnasium](gymnasium.md) and [Soar](soar.md) have numbers of their own "
        "(`python -m benchmarks gym`, `soar`).\n\n"
    )


def _configured() -> str:
    """Return how Python was built: without optimisation it makes 0.6 to 0.75 of the steps.

    Debian optimises its own by other means, which do not stand there.
    """
    arguments = sysconfig.get_config_var("CONFIG_ARGS") or ""
    return f"configured with{'' if '--enable-optimizations' in arguments else 'out'} --enable-optimizations"


def _busy_seconds() -> float:
    """Return the busy time of all processors together since the machine was started, in seconds."""
    user, nice, system, _, _, irq, softirq, *_ = map(
        int, Path("/proc/stat").read_text().split("\n")[0].split()[1:]
    )
    return (user + nice + system + irq + softirq) / os.sysconf("SC_CLK_TCK")


def _processor() -> str:
    try:
        for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    except OSError:
        pass
    return platform.processor() or "unknown processor"
