"""Installed packages: their entry points, by which players and what belongs to them are found, and extras."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import lru_cache
from typing import TYPE_CHECKING, Any

from glue.errors import ConfigError, GlueError

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


@contextmanager
def needing(extra: str, why: str, error: type[GlueError] = ConfigError) -> Iterator[None]:
    """Name the extra to install if an import inside fails; `why` says what needs which package."""
    try:
        yield
    except ImportError:
        raise error(f"{why}: pip install 'glue-rl[{extra}]'") from None
