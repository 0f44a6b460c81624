"""Files are replaced as a whole; JSON has only numbers that it can represent, and CSV no formulas."""

from __future__ import annotations

import contextlib
import math
import os
from collections.abc import Iterator, Sequence
from pathlib import Path

from experiment_runner.store.database import reported
from glue.console import cell


def finite(value: object) -> object:
    """Return `value`, or None if it is infinite or NaN, which JSON cannot represent."""
    return None if isinstance(value, float) and not math.isfinite(value) else value


def csv_row(cells: Sequence[object]) -> list[object]:
    """Return the cells of a row of CSV: booleans are `true` and `false`, and no text is a formula."""
    return [
        str(value).lower() if isinstance(value, bool) else cell(value) if isinstance(value, str) else value
        for value in cells
    ]


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
