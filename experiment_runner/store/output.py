"""What is written for others: a file that is there whole or not at all, numbers that JSON has."""

from __future__ import annotations

import contextlib
import math
import os
from collections.abc import Iterator
from pathlib import Path

from experiment_runner.store.database import reported

__all__ = ["finite", "written"]


def finite(value: object) -> object:
    """Return `value`, or None if it is infinite or not a number, for which JSON has no word."""
    return None if isinstance(value, float) and not math.isfinite(value) else value


@contextlib.contextmanager
def written(path: Path) -> Iterator[Path]:
    """Give a path to write to, which becomes `path` at the end, or vanishes on an exception.

    A device or pipe, such as /dev/stdout, is written to directly.

    Raises:
        ExperimentError: the file cannot be written.
    """
    target = path.resolve()  # a link stays a link
    with reported(f"cannot write {path}"):
        if target.exists() and not target.is_file():
            yield target
            return
        partial = target.with_name(f".{target.name}.{os.getpid()}")
        try:
            yield partial
            partial.replace(target)
        finally:
            partial.unlink(missing_ok=True)
