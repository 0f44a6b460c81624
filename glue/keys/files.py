"""Files that only their owner, or root, can have written."""

from __future__ import annotations

import os
import stat
from pathlib import Path
from typing import Final

from glue.errors import ConfigError
from glue.files import open_regular

_OTHERS: Final = 0o077
_OTHERS_WRITE: Final = 0o022

_MAX_LINKS: Final = 40
"""Maximum number of symbolic links on the way to a file, as in Linux."""


def read_own(path: Path, limit: int, secret: bool = False) -> bytes:
    """Return the content of a file that no other user can have written.

    The file, every folder and every symbolic link on the way to it belong to this user or to root, and others
    can neither write to the file nor replace it, such a link, or a folder.

    Args:
        path: the file.
        limit: maximum size, in bytes.
        secret: whether the file must not be readable by others either.

    Raises:
        FileNotFoundError: there is no such file.
        ConfigError: others can change or replace the file, or it cannot be read, is not a regular file, or is
            too large.
    """
    try:
        _check_way(path)
        with open_regular(path, most=limit, follow=True) as file:
            state = os.fstat(file.fileno())
            _check_owner(path, state)
            if secret and state.st_mode & _OTHERS:
                raise ConfigError(
                    f"{path} holds a secret key, and other users of this machine can read it: "
                    f"chmod 600 {path} (and make a new pair if somebody may have)"
                )
            _check_mode(path, state)
            return file.read(limit)
    except FileNotFoundError:
        raise
    except OSError as error:
        raise ConfigError(f"cannot read {path}: {error.strerror}") from None


def check_directory(path: Path) -> None:
    """Check that no other user can replace files in a directory.

    Raises:
        ConfigError: the directory belongs to another user, or others can write to it, or replace it.
    """
    try:
        _check_way(path)
        state = path.stat()
    except OSError as error:
        raise ConfigError(f"cannot read {path}: {error.strerror}") from None
    _check_owner(path, state)
    _check_mode(path, state)


def _check_way(path: Path) -> None:
    """Follow the folders and symbolic links on the way to `path`, and check each of them."""
    at = Path("/")
    ahead = list(path.absolute().parts[1:])
    links = 0
    while ahead:
        part = ahead.pop(0)
        if part == "..":
            at = at.parent
            continue
        _check_folder(at)
        at /= part
        state = at.lstat()
        if stat.S_ISLNK(state.st_mode):
            links += 1
            if links > _MAX_LINKS:
                raise ConfigError(f"cannot read {path}: more than {_MAX_LINKS} symbolic links lead to it")
            _check_owner(at, state)
            target = Path(os.readlink(at))
            at = Path("/") if target.is_absolute() else at.parent
            ahead = [*(target.parts[1:] if target.is_absolute() else target.parts), *ahead]


def _check_folder(path: Path) -> None:
    """Check that no other user can replace entries of this user or of root in a directory."""
    state = path.stat()
    _check_owner(path, state)
    if not state.st_mode & stat.S_ISVTX:
        _check_mode(path, state)


def _check_owner(path: Path, state: os.stat_result) -> None:
    if state.st_uid not in (0, os.geteuid()):
        raise ConfigError(
            f"{path} belongs to another user of this machine (number {state.st_uid}), who can exchange it: "
            f"chown {os.geteuid()} {path}, or use a copy of your own"
        )


def _check_mode(path: Path, state: os.stat_result) -> None:
    if state.st_mode & _OTHERS_WRITE:
        raise ConfigError(f"other users of this machine can change or exchange {path}: chmod go-w {path}")
