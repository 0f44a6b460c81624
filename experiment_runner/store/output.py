"""Files and numbers: files are replaced as a whole, untrusted ones are read within limits, and JSON has only
numbers that it can represent."""

from __future__ import annotations

import contextlib
import math
import os
import stat
from collections.abc import Iterator
from pathlib import Path

from experiment_runner.store.database import reported


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


def read_regular(path: Path, most: int, *, own: bool = False) -> bytes:
    """Return the beginning of a file that may come from anyone; empty unless it is a regular file.

    Symbolic links are not followed, and reading a pipe does not block.

    Args:
        path: path of the file.
        most: maximum number of bytes to read.
        own: whether the file must belong to this user.
    """
    try:
        file = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK)
    except OSError:
        return b""
    with os.fdopen(file, "rb") as opened:
        status = os.fstat(file)
        if not stat.S_ISREG(status.st_mode) or (own and status.st_uid != os.getuid()):
            return b""
        return opened.read(most)
