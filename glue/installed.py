"""The entry points of installed packages, by which players and what belongs to them are found."""

from __future__ import annotations

import os
import sys
from contextlib import suppress
from functools import lru_cache
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from importlib.metadata import EntryPoints


def entry_points(group: str) -> EntryPoints:
    """Return the entry points of a group; those of all groups are read once, until a package is installed."""
    folders = tuple((folder, _changed(folder or ".")) for folder in sys.path)
    found: EntryPoints = _all(folders).select(group=group)
    return found


@lru_cache(maxsize=1)
def _all(_folders: tuple[tuple[str, int], ...]) -> Any:
    """Return all entry points; the folders with their times tell whether they may be others by now."""
    from importlib import metadata  # slow to import

    return metadata.entry_points()  # its type depends on Python's version


def _changed(folder: str) -> int:
    with suppress(OSError):
        return os.stat(folder).st_mtime_ns
    return 0
