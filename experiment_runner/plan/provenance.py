"""The provenance of a run: the command, the program's version, the installed packages, the machine."""

from __future__ import annotations

import os
import platform
import shlex
import subprocess
import sys
from functools import cache
from importlib import metadata
from pathlib import Path
from typing import Any, Final

from glue import __version__

_GIT_SECONDS: Final = 10


def about() -> dict[str, Any]:
    """Return the contents of `run.json`: strings, numbers, None, and dictionaries of these.

    `repository` is the commit of the working directory, if it is in a git repository; `files` is empty.
    """
    return {
        "program": program(),
        "command": shlex.join([Path(sys.argv[0]).name, *sys.argv[1:]]),
        "folder": str(Path.cwd()),
        "repository": _repository(Path.cwd()),
        "files": {},
        "python": platform.python_version(),
        "packages": _packages(),
        "machine": {
            "name": platform.node(),
            "system": platform.platform(),
            "processor": _processor(),
            "cores": os.cpu_count() or 1,
        },
    }


@cache
def program() -> str:
    """Return this program's version, as in `glue-rl 0.3.0, commit 1a2b3c, modified`, as of the first call."""
    parts = [f"glue-rl {__version__}"]
    here = Path(__file__).resolve()
    # An installed copy may be inside another repository, whose commit is irrelevant.
    if _git("ls-files", "--error-unmatch", here.name, folder=here.parent) is not None:
        commit = _git("rev-parse", "--short=12", "HEAD", folder=here.parent)
        if commit:
            parts.append(f"commit {commit}")
            if _git("status", "--porcelain", "--untracked-files=no", folder=here.parent):
                parts.append("modified")
    return ", ".join(parts)


@cache
def _packages() -> dict[str, str]:
    """Return the version of each installed distribution, by name."""
    found = map(_fields, metadata.distributions())
    versions = [(fields["Name"], fields["Version"]) for fields in found if "Name" in fields]
    return dict(sorted(versions, key=lambda one: one[0].lower()))


def _fields(distribution: metadata.Distribution) -> dict[str, str]:
    """Return the first value of each field; `distribution.metadata` would parse the description too."""
    text = distribution.read_text("METADATA") or distribution.read_text("PKG-INFO") or ""
    lines = text.partition("\n\n")[0].splitlines()
    return dict(line.partition(": ")[::2] for line in reversed(lines))


def _repository(folder: Path) -> dict[str, object] | None:
    commit = _git("rev-parse", "HEAD", folder=folder)
    if not commit:
        return None
    clean = not _git("status", "--porcelain", "--untracked-files=no", folder=folder)
    return {"commit": commit, "clean": clean}


def _git(*arguments: str, folder: Path) -> str | None:
    try:
        done = subprocess.run(
            # Without its lock on the index, which a kill would leave in the user's repository.
            ["git", "--no-optional-locks", "-C", str(folder), *arguments],
            capture_output=True,
            text=True,
            timeout=_GIT_SECONDS,
        )
    except (OSError, subprocess.TimeoutExpired):
        return None
    return done.stdout.strip() if done.returncode == 0 else None


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        lines = []
    models = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return models[0] if models else platform.processor() or platform.machine()
