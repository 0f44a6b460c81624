"""The previous version, measured for comparison with this one.

GLUE_PREVIOUS names a folder with a checkout of that version and its virtual environment in `.venv`; if it is
not set, nothing is measured.
"""

from __future__ import annotations

import os
import subprocess
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final

from benchmarks.measure import Rate

CHECKOUT: Final = Path(os.environ["GLUE_PREVIOUS"]) if "GLUE_PREVIOUS" in os.environ else None
"""The folder, if there is one."""

_MEASURE: Final = """
import sys
from benchmarks.hub import _many_sessions

with _many_sessions(int(sys.argv[1])) as measure:
    measure()
    for _ in sys.stdin:
        result = measure()
        print(getattr(result, "per_second", result), flush=True)
"""


@contextmanager
def previous_sessions(number: int) -> Iterator[Callable[[], Rate]]:
    """Yield a measure of steps per second of many sessions on one hub of the previous version."""
    assert CHECKOUT is not None
    command = [str(CHECKOUT / ".venv/bin/python"), "-c", _MEASURE, str(number)]
    with subprocess.Popen(
        command, cwd=CHECKOUT, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as process:
        requests, results = process.stdin, process.stdout
        assert requests is not None
        assert results is not None

        def measure() -> Rate:
            print(file=requests, flush=True)
            return Rate(float(results.readline()), 0.0)

        yield measure
        requests.close()
