"""The user's files that a run loads: its classes, the modules that they import, files that options name.

Installed packages are identified by their version, and this program by its commit, see `provenance`. A module
that is imported only while an episode runs is not found.
"""

from __future__ import annotations

import hashlib
import sys
import sysconfig
from collections.abc import Container, Iterable, Iterator, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Final, NamedTuple, TypeVar

import glue
from experiment_runner.plan.plan import RoleSpec, RoleSweep, class_files
from glue.options import Value
from glue.plugins.loading import PACKAGES, all_modules, file_in, is_installed

_LOADED_BEFORE: Final = frozenset(sys.modules)
_MAX_COPY: Final = 2**24
"""Maximum size in bytes of a file that a run copies."""

_Values = TypeVar("_Values", Value, Value | tuple[Value, ...])


class UserFile(NamedTuple):
    """A file of the user's.

    sha256   digest of its contents, in hexadecimal
    content  its contents; None if it is too large for a copy
    """

    sha256: str
    content: bytes | None


def user_files(players: Sequence[RoleSpec | RoleSweep]) -> dict[str, UserFile]:
    """Return the user's files that players load, by absolute path. Their classes must have been found.

    Raises:
        OSError: a file cannot be read.
    """
    paths = {Path(file).resolve() for file in class_files(players)}
    return {str(path): file_at(path) for path in sorted({*paths, *_modules(), *_named_by_options(players)})}


def changed_files(recorded: Mapping[str, str], present: Mapping[str, UserFile]) -> list[str]:
    """Return the paths of the files that differ from those recorded, given by path and SHA-256.

    A recorded module that is not loaded may be loaded later. A file of an option that is not loaded may be
    gone, or was moved, which does no harm: the player that needs it says so. It differs only if options name
    a file now with which the run did not begin.
    """
    begun = {(Path(path).name, sha256) for path, sha256 in recorded.items()}
    named = {(Path(path).name, file.sha256) for path, file in present.items() if not path.endswith(".py")}
    others = not named <= begun
    return [
        path
        for path, sha256 in recorded.items()
        if (
            present[path].sha256 != sha256
            if path in present
            else others and not path.endswith(".py") and (Path(path).name, sha256) not in named
        )
    ]


def with_digests(options: Mapping[str, _Values], known: Container[str]) -> dict[str, _Values]:
    """Return a player's options with the SHA-256 of the files that they name, which the player then checks.

    Args:
        options: by name.
        known: the names of all its options; the one for the digest of the file of NAME is NAME_digest.

    Raises:
        OSError: a file cannot be read.
    """
    digests: dict[str, _Values] = {
        f"{name}_digest": file_at(Path(value)).sha256
        for name, value in options.items()
        if f"{name}_digest" in known and isinstance(value, str) and _is_file(value)
    }
    return {**options, **{name: digest for name, digest in digests.items() if name not in options}}


def file_at(path: Path) -> UserFile:
    """Return the digest and the contents of a file.

    Raises:
        OSError: it cannot be read.
    """
    with path.open("rb") as file:
        digest = hashlib.file_digest(file, "sha256").hexdigest()
        if file.tell() > _MAX_COPY:
            return UserFile(digest, None)
        file.seek(0)
        return UserFile(digest, file.read())


def players_of(player: RoleSpec | RoleSweep) -> list[str]:
    """Return the name of a player, and of the opponents in its game that may not be installed."""
    opponents = _texts_in([player.options.get("opponent", ())])
    return [player.name, *(name for name in opponents if ":" in name)]


def named_code(players: Sequence[RoleSpec | RoleSweep | None]) -> list[str]:
    """Return the classes, files and addresses of these players that may do harm here, without duplicates.

    These are classes, also of opponents in games, that are not installed, shown by their file if they have
    one; files that options name, such as a policy or Soar's productions, which may execute code; and
    addresses in options, whose owners would be sent observations, and the user's key. A file whose digest is
    an option, too, holds data.
    """
    known = [player for player in players if player is not None]
    names = {name for player in known for name in players_of(player)}
    installed = {name for name in names if is_installed(name)}
    found: list[str] = []
    for player in known:
        found += [file_in(name) or name for name in players_of(player) if name not in installed]
        options = player.options
        for one in _texts_in(value for name, value in options.items() if f"{name}_digest" not in options):
            if _is_file(one) or "://" in one:
                found.append(one if "://" in one else str(Path(one).resolve()))
    return list(dict.fromkeys(found))


def _modules() -> Iterator[Path]:
    for name, module in all_modules():
        file = getattr(module, "__file__", None)
        if name in _LOADED_BEFORE or name == "__main__" or not isinstance(file, str):
            continue
        path = _own(file)
        if path is not None and path.is_file():  # torch's in-memory modules name files that do not exist
            yield path


@cache
def _own(file: str) -> Path | None:
    """Return the path of a module's file; None if it is installed or ours. A program may open many runs."""
    path = Path(file).resolve()
    installed = {"site-packages", "dist-packages"}.intersection(path.parts)
    own = path.suffix == ".py" and not installed and not _others().intersection(path.parents)
    return path if own else None


@cache
def _others() -> frozenset[Path]:
    """Return the folders of the standard library, of installed packages, and of our own."""
    libraries = {Path(folder).resolve() for folder in sysconfig.get_paths().values()}
    return frozenset(libraries | {Path(glue.__file__).resolve().parents[1] / name for name in PACKAGES})


def _named_by_options(players: Sequence[RoleSpec | RoleSweep]) -> Iterator[Path]:
    for player in players:
        yield from (Path(one).resolve() for one in _texts_in(player.options.values()) if _is_file(one))


def _texts_in(values: Iterable[Value | tuple[Value, ...]]) -> Iterator[str]:
    for value in values:
        yield from (one for one in (value if isinstance(value, tuple) else (value,)) if isinstance(one, str))


def _is_file(name: str) -> bool:
    try:
        return Path(name).is_file()
    except (OSError, ValueError):  # too long for a name, or with a null character
        return False
