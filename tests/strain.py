"""Runs the suite again and again under strain, and prints a table: `python -m tests.strain --loops 4`.

With `--loops` as many busy loops take the processors beside it, and with `--core` it has a single core. With
`--shuffle` the modules, and the tests of each, run in another order each time. What follows `--` are options
of pytest.
"""

from __future__ import annotations

import argparse
import os
import random
import re
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final

import pytest

ROOT: Final = Path(__file__).parents[1]
PARALLEL: Final = ("--numprocesses=3", "--dist=loadfile", "--no-loadscope-reorder")
ORDER: Final = "ORDER_OF_TESTS"
"""Environment variable with the seed of the order. Tests look for variables whose names begin with GLUE."""


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Shuffle, as a plugin of the suite: the tests of a module stay together, as they share its fixtures."""
    chance = random.Random(os.environ[ORDER])
    rank = {path: chance.random() for path in sorted({item.path for item in items})}
    items.sort(key=lambda item: (rank[item.path], chance.random()))


@contextmanager
def busy(loops: int) -> Iterator[None]:
    """Run busy loops meanwhile."""
    started = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(loops)]
    try:
        yield
    finally:
        for loop in started:
            loop.kill()
            loop.wait()


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=20)
    parser.add_argument("--loops", type=int, default=0)
    parser.add_argument("--core", action="store_true", help="one core, for the loops, too")
    parser.add_argument("--shuffle", action="store_true", help="another order in each run")
    parser.add_argument("options", nargs="*", help="options of pytest")
    asked = parser.parse_args()
    if asked.core:
        os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    plugin = ["-p", "tests.strain"] if asked.shuffle else []
    command = [sys.executable, "-m", "pytest", "-q", *PARALLEL, *plugin, *asked.options]
    failed = 0
    with busy(asked.loops):
        for run in range(1, asked.runs + 1):
            began = time.monotonic()
            env = {**os.environ, ORDER: str(run)}
            printed = subprocess.run(command, cwd=ROOT, env=env, capture_output=True, text=True, check=False)
            lines = printed.stdout.splitlines()
            failures = re.findall(r"^(?:FAILED|ERROR) (\S+)", printed.stdout, re.MULTILINE)
            print(
                f"{run:3} {time.monotonic() - began:6.0f} s  {lines[-1] if lines else ''}",
                *failures,
                flush=True,
            )
            failed += printed.returncode != 0
    print(f"{asked.runs - failed} of {asked.runs} runs green")
    return failed


if __name__ == "__main__":
    sys.exit(main())
