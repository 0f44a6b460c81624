"""Writing a file so that it is there whole or not at all."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path

from experiment_runner.database import reported

__all__ = ["written"]


@contextlib.contextmanager
def written(path: Path) -> Iterator[Path]:
    """Give a path to write to, which becomes `path` at the end, or vanishes on an exception.

    Raises:
        ExperimentError: the file cannot be written.
    """
    partial = path.with_name(f".{path.name}.{os.getpid()}")
    with reported(f"cannot write {path}"):
        try:
            yield partial
            partial.replace(path)
        finally:
            partial.unlink(missing_ok=True)
