"""Check that a release can be made from this commit: `make release`."""

from __future__ import annotations

import re
import subprocess
from datetime import date

from glue import __version__
from tests.house.imports import ROOT


def faults(changelog: str, citation: str, tags: list[str], changed: str) -> list[str]:
    """Return a line for each obstacle to a release of the version.

    Args:
        changelog: text of CHANGELOG.md.
        citation: text of CITATION.cff.
        tags: names of the tags of this commit.
        changed: files that differ from this commit, as `git status --short` lists them.
    """
    found = []
    if not re.search(rf"^## {re.escape(__version__)} \(\d{{4}}-\d\d-\d\d\)$", changelog, re.MULTILINE):
        heading = f"## {__version__} ({date.today()})"
        found.append(f"CHANGELOG.md has no section of this version and a date: {heading}")
    if not re.search(rf"^version: {re.escape(__version__)}$", citation, re.MULTILINE):
        found.append(f"CITATION.cff is of another version than {__version__}")
    if f"v{__version__}" not in tags:
        found.append(f"this commit has no tag v{__version__}: git tag --sign v{__version__}")
    if changed:
        found.append(f"files are not committed:\n{changed}")
    return found


def _git(*arguments: str) -> str:
    return subprocess.run(["git", *arguments], cwd=ROOT, capture_output=True, text=True, check=True).stdout


def main() -> int:
    """Print the obstacles; return the exit code."""
    changelog, citation = ((ROOT / name).read_text("utf-8") for name in ("CHANGELOG.md", "CITATION.cff"))
    missing = faults(
        changelog, citation, _git("tag", "--points-at", "HEAD").split(), _git("status", "--short").rstrip()
    )
    print(*(missing or [f"version {__version__} can be released"]), sep="\n")
    return 1 if missing else 0


if __name__ == "__main__":
    raise SystemExit(main())
