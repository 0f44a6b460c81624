"""Numbered levels, and named sets of them, to train on some levels and test on others.

Level `n` of a set with D difficulties has a type, a difficulty and a seed:

    type        n mod 3
    difficulty  (n div 3) mod D
    seed        the upper 31 bits of SplitMix64's n-th output, because Java's generator makes
                similar levels from neighbouring seeds

so a set holds all types and difficulties, in nearly equal numbers. A set never changes: other rules would
need another `VERSION` and other names. A set may also be a folder of levels in files.

Source of the hash: Steele, Lea and Flood (2014), Fast splittable pseudorandom number generators.
"""

from __future__ import annotations

import hashlib
from dataclasses import replace
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from env_server.mario.parameters import Parameters
from env_server.mario.pictures import digest_of, read_picture
from glue.compiled.jit import entry, jit
from glue.console import did_you_mean
from glue.errors import ConfigError

VERSION: Final = 1
TYPES: Final = 3
DIFFICULTIES: Final = 4
_LAST: Final = 2**31 - 1
_MOST_FILES: Final = 10_000
_DIGITS: Final = 12  # of a folder's digest


class LevelSet(NamedTuple):
    """Numbered levels, whose difficulties are counted from 0."""

    numbers: range
    difficulties: int = DIFFICULTIES

    def difficulty(self, number: int) -> int:
        """Return the difficulty of level `number`."""
        return number // TYPES % self.difficulties

    def options(self, number: int) -> dict[str, Any]:
        """Return the options of Infinite Mario for level `number`."""
        kind, difficulty = number % TYPES, self.difficulty(number)
        return {"level_seed": int(level_seed(number)), "level_type": kind, "level_difficulty": difficulty}

    def level(self, task: Parameters, number: int) -> Parameters:
        """Return `task` on level `number`."""
        return replace(task, **self.options(number))

    def title(self, number: int) -> str:
        """Return the name of level `number`."""
        return f"level {number}"


class LevelFolder(NamedTuple):
    """The levels in the files of a folder, numbered from 0; all have difficulty 0.

    Attributes:
        name: of the set: the folder, and a digest of the names and contents of its files, as in
            `levels#3f2a91c07be1`.
        files: path and SHA-256 of each.
    """

    name: str
    files: tuple[tuple[Path, str], ...]

    @property
    def numbers(self) -> range:
        """The numbers of the levels."""
        return range(len(self.files))

    def difficulty(self, number: int) -> int:
        """Return 0."""
        return 0

    def options(self, number: int) -> dict[str, Any]:
        """Return the options of Infinite Mario for level `number`."""
        path, sha256 = self.files[number]
        return {"level": str(path), "level_digest": sha256}

    def level(self, task: Parameters, number: int) -> Parameters:
        """Return `task` on level `number`.

        Raises:
            ConfigError: its file has changed, or holds no level.
        """
        picture = read_picture(*self.files[number])
        return replace(task, level=picture, **picture.parameters)

    def title(self, number: int) -> str:
        """Return the name of level `number`."""
        return self.files[number][0].name


def read_folder(name: str) -> LevelFolder:
    """Return the levels in the files `*.txt` of a folder, in the order of their names.

    Args:
        name: the folder; or with #DIGEST, as in `LevelFolder.name`, unless a folder has that very name.

    Raises:
        ConfigError: it has no such files or too many, or the digest is another.
    """
    folder, digest = name, ""
    if "#" in name and not Path(name).is_dir():
        folder, _, digest = name.rpartition("#")
    paths = sorted(Path(folder).glob("*.txt"))
    if not 1 <= len(paths) <= _MOST_FILES:
        raise ConfigError(f"{folder} has {len(paths)} levels *.txt: expected 1 to {_MOST_FILES}")
    files = tuple((path, digest_of(path)) for path in paths)
    whole = "".join(f"{path.name} {sha256}\n" for path, sha256 in files)
    found = hashlib.sha256(whole.encode(errors="surrogateescape")).hexdigest()[:_DIGITS]
    if digest not in ("", found):
        raise ConfigError(f"the levels in {folder} have changed: their digest is {found}, not {digest}")
    return LevelFolder(f"{folder}#{found}", files)


LEVEL_SETS: Final = {
    "train-200": LevelSet(range(200)),
    "train-500": LevelSet(range(500)),
    "test-1000": LevelSet(range(1_000_000, 1_001_000)),
    "ladder-v1": LevelSet(range(2_000_000, 2_016_032), 16),
}
"""The sets by name. The two training sets overlap; no other two sets have a level in common."""


def resolve_levels(
    levels: str | None, num_levels: int | None = None, start_level: int | None = None
) -> LevelSet | None:
    """Return the set named `levels`, or the set of `num_levels` levels from `start_level` on.

    Returns:
        None without arguments: the only level is that of the task.

    Raises:
        ConfigError: the set is unknown, both forms are given, or a number is out of range.
    """
    if levels is not None:
        if num_levels is not None or start_level is not None:
            raise ConfigError("levels names a set: leave out num_levels and start_level")
        if not isinstance(levels, str) or levels not in LEVEL_SETS:
            raise ConfigError(
                f"no set of levels is called {levels!r:.80}{did_you_mean(str(levels), LEVEL_SETS)}"
            )
        return LEVEL_SETS[levels]
    for name, number in (("num_levels", num_levels), ("start_level", start_level)):
        if not isinstance(number, int | np.integer | None):
            raise ConfigError(f"{name} takes a whole number, not {number!r:.80}")
    if num_levels is None:
        if start_level is not None:
            raise ConfigError(f"start_level={start_level} needs num_levels: how many levels there are")
        return None
    first = 0 if start_level is None else start_level
    if not 0 <= first <= _LAST:
        raise ConfigError(f"start_level must be from 0 to {_LAST}, not {first}")
    if not 1 <= num_levels <= _LAST + 1 - first:
        raise ConfigError(
            f"num_levels must be from 1 to {_LAST + 1 - first} after level {first}, not {num_levels}"
        )
    return LevelSet(range(int(first), int(first + num_levels)))


@jit
def splitmix(number: np.uint64) -> np.uint64:
    """Return output `number` of SplitMix64 seeded with 0, counted from 0."""
    state = (number + np.uint64(1)) * np.uint64(0x9E3779B97F4A7C15)
    state = (state ^ (state >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    state = (state ^ (state >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return state ^ (state >> np.uint64(31))


@entry
def level_seed(number: int) -> int:
    """Return the seed of level `number`, 0 to 2**31 - 1."""
    return int(splitmix(np.uint64(number)) >> np.uint64(33))
