"""Detect packages of other distributions that have the names of ours; see `glue_rl`."""

from __future__ import annotations

import os
import sys
from itertools import takewhile

TYPE_CHECKING = False  # not imported: see glue.cli.entry
if TYPE_CHECKING:
    from collections.abc import Iterable
    from typing import Final

NAMES: Final = ("glue", "agents", "env_server", "experiment_runner")

_HOME: Final = os.path.dirname(os.path.dirname(os.path.realpath(__file__)))


def others(folders: Iterable[str]) -> dict[str, str]:
    """Return the file of the first foreign package in `folders` with a name of ours, for each such name."""
    found: dict[str, str] = {}
    for folder in folders:
        if os.path.realpath(folder) == _HOME:
            continue
        for name in NAMES:
            for file in (os.path.join(folder, name, "__init__.py"), os.path.join(folder, f"{name}.py")):
                if name not in found and os.path.isfile(file):
                    found[name] = file
    return found


def hidden_names() -> str:
    """Return a line about packages that Python finds before ours, with the remedy; empty if there is none."""
    hidden = others(takewhile(lambda folder: os.path.realpath(folder) != _HOME, sys.path))
    if not hidden:
        return ""
    return (
        f"{', '.join(hidden.values())} hides a package of glue-rl: import glue_rl before other packages, "
        "or give glue-rl an environment of its own"
    )
