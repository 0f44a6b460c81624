"""Mistakes of the hub and of its clients that the simulator has to find: python -m tests.simulation.mutants.

Each is a change of one place in the source, listed in mutants.toml and tried on a copy of it.
"""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final, NamedTuple

ROOT: Final = Path(__file__).parents[2]

SEEDS: Final = 2000
"""Number of seeds within which each mutant has to be found."""


class Mutant(NamedTuple):
    """A change of the source."""

    mistake: str
    file: str
    before: str
    """Text that occurs in the file exactly once."""

    after: str


MUTANTS: Final = [
    Mutant(**row) for row in tomllib.loads(Path(__file__).with_suffix(".toml").read_text("utf-8"))["mutant"]
]


def first_seed(mutant: Mutant, seeds: int = SEEDS) -> tuple[int, str] | None:
    """Return the first seed that breaks a promise, and the promise; None if no seed does."""
    with TemporaryDirectory() as folder:
        for part in ("glue", "tests/simulation"):
            shutil.copytree(ROOT / part, Path(folder) / part, ignore=shutil.ignore_patterns("__pycache__"))
        shutil.copy(ROOT / "tests/weighing.py", Path(folder) / "tests")
        changed = Path(folder) / mutant.file
        source = changed.read_text(encoding="utf-8")
        if source.count(mutant.before) != 1:
            raise ValueError(f"{mutant.mistake}: its text occurs {source.count(mutant.before)} times")
        changed.write_text(source.replace(mutant.before, mutant.after), encoding="utf-8")
        command = [sys.executable, "-m", "tests.simulation", "--seeds", str(seeds), "--stop"]
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    found = re.search(r"^seed (\d+): (.*)", done.stdout, re.MULTILINE)
    if found is None and done.returncode:
        raise ValueError(f"{mutant.mistake}: {done.stderr[-2000:]}")
    return None if found is None else (int(found[1]), found[2])


def main() -> None:
    """Print the table of docs/verification.md."""
    print("| mistake | seed | what is noticed |\n| --- | --- | --- |")
    for mutant in MUTANTS:
        found = first_seed(mutant)
        seed, noticed = ("none", "") if found is None else found
        print(f"| {mutant.mistake} | {seed} | {noticed:.100} |", flush=True)


if __name__ == "__main__":
    main()
