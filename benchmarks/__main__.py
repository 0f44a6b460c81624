"""`python -m benchmarks [NAME ...]`: measure, and write docs/performance.md (all of it) or print (some)."""

from __future__ import annotations

import importlib
import os
import platform
import sys
from pathlib import Path

import msgpack
import numba
import numpy as np
import zmq

from benchmarks.measure import REPEATS, Table

_MODULES = ("hub", "attacks", "legacy", "mario", "gym", "agents", "soar", "experiment", "competition")
_BY_NAME = ("clients", "memory", "view")
"""Those that are only measured when they are named: they take long, or have to be built first."""
_QUIET_LOAD = 0.5
_NOTES = Path(__file__).parent / "notes.md"
_FILE = Path(__file__).parent.parent / "docs" / "performance.md"


def main(names: list[str]) -> None:
    """Measure what `names` name, or everything."""
    unknown = set(names) - {*_MODULES, *_BY_NAME}
    if unknown:
        known = ", ".join((*_MODULES, *_BY_NAME))
        sys.exit(f"no benchmark is called {', '.join(sorted(unknown))}: there are {known}")
    load = os.getloadavg()[1]
    tables: list[Table] = []
    for name in names or _MODULES:
        print(f"measuring {name} ...", file=sys.stderr, flush=True)
        tables += importlib.import_module(f"benchmarks.{name}").run()
    if names:
        print("\n".join(map(str, tables)))
    else:
        _FILE.write_text(
            "\n".join([_head(load), *map(str, tables), _NOTES.read_text("utf-8")]), encoding="utf-8"
        )
        print(f"written to {_FILE}", file=sys.stderr)


def _load(load: float) -> str:
    """Return how quiet the machine was, from the processes that were running before the first measurement."""
    if load < _QUIET_LOAD:
        return f"It was quiet before (load {load:.1f})."
    return f"It was busy with other work (load {load:.1f} before the first measurement)."


def _head(load: float) -> str:
    return (
        "# Performance\n\n"
        "Written by `make bench`; repeat it on your own machine. Each number is the median of at least "
        f"{REPEATS} repeats, those of one table taken in turn. Whatever else a machine does moves numbers "
        "more than their ratios within a table, so ratios come first.\n\n"
        f"Machine: {_processor()}, {os.cpu_count()} cores, {platform.system()} {platform.machine()}; "
        f"Python {platform.python_version()}, pyzmq {zmq.__version__} (libzmq {zmq.zmq_version()}), "
        f"msgpack {'.'.join(map(str, msgpack.version))}, NumPy {np.__version__}, numba {numba.__version__}. "
        f"{_load(load)}\n"
    )


def _processor() -> str:
    try:
        for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    except OSError:
        pass
    return platform.processor() or "unknown processor"


if __name__ == "__main__":
    main(sys.argv[1:])
