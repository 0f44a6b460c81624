"""Writing files for users: complete or not at all, and only with numbers that JSON can represent."""

from __future__ import annotations

import contextlib
import math
import os
from collections.abc import Iterator
from pathlib import Path

from experiment_runner.store.database import reported

__all__ = ["finite", "written"]


def finite(value: object) -> object:
    """Return `value`, or None if it is infinite or NaN, which JSON cannot represent."""
    return None if isinstance(value, float) and not math.isfinite(value) else value


@contextlib.contextmanager
def written(path: Path) -> Iterator[Path]:
    """Yield a temporary path to write to; it is renamed to `path` at the end, or removed on an exception.

    A device or pipe, such as /dev/stdout, is written to directly.

    Raises:
        ExperimentError: the file cannot be written.
    """
    target = path.resolve()  # a symbolic link is not replaced
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
