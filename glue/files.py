"""Files in folders that others may have laid, or can write to: the only way in which they are opened.

A symbolic link is not followed, since it may lead to a file of the user's; only a regular file is opened,
since a FIFO blocks, a device may never end, and opening one may do something; and no more is read than a
stated size. A file that is refused raises an `OSError` whose `strerror` says what it is instead.
"""

from __future__ import annotations

import errno
import os
import stat
from io import BufferedReader, BufferedWriter
from pathlib import Path
from typing import Final

_ALWAYS: Final = os.O_CLOEXEC | os.O_NONBLOCK | os.O_NOCTTY

MOST_TEXT: Final = 2**26
"""Maximum size of a text file of a run, in bytes."""


def descriptor_of(path: Path, flags: int, mode: int = 0o666, *, follow: bool = False) -> int:
    """Return the descriptor of a regular file.

    Args:
        path: of the file.
        flags: as of `os.open`; a file must not be truncated by them, because it has not been checked yet.
        mode: of a file that is created.
        follow: follow symbolic links: the user has named the file.

    Raises:
        OSError: there is no such file, it cannot be opened, or it is not a regular file.
    """
    try:
        descriptor = os.open(path, flags | _ALWAYS | (0 if follow else os.O_NOFOLLOW), mode)
    except OSError as error:
        if not follow and path.is_symlink():
            raise OSError(errno.ELOOP, "it is a symbolic link, which is not followed", str(path)) from None
        if error.errno == errno.ENXIO:  # a socket, or a FIFO that nothing reads
            raise _irregular(path) from None
        raise
    kind = os.fstat(descriptor).st_mode
    if not stat.S_ISREG(kind):
        os.close(descriptor)
        if stat.S_ISDIR(kind):
            raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
        raise _irregular(path)
    return descriptor


def open_regular(path: Path, *, most: int | None = None, follow: bool = False) -> BufferedReader:
    """Return a regular file, opened for reading.

    Args:
        path, follow: as of `descriptor_of`.
        most: maximum size in bytes.

    Raises:
        OSError: as by `descriptor_of`; or it is larger.
    """
    file = open(descriptor_of(path, os.O_RDONLY, follow=follow), "rb")  # noqa: SIM115 - the caller closes it
    if most is not None and os.fstat(file.fileno()).st_size > most:
        file.close()
        raise OSError(errno.EFBIG, f"it has more than {most:,} bytes", str(path))
    return file


def create_regular(path: Path, mode: int = 0o666) -> BufferedWriter:
    """Return a new file, opened for writing; one that is there, or a link, is replaced and not written to.

    Raises:
        OSError: it cannot be written.
    """
    path.unlink(missing_ok=True)
    return open(descriptor_of(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, mode), "wb")


def read_regular(path: Path, most: int, *, follow: bool = False, own: bool = False) -> bytes:
    """Return the contents of a regular file.

    Args:
        path: of the file.
        most: maximum size in bytes.
        follow: as of `descriptor_of`.
        own: whether it must belong to this user.

    Raises:
        OSError: it cannot be read, is not a regular file, or is larger.
    """
    with open_regular(path, most=most, follow=follow) as file:
        if own and os.fstat(file.fileno()).st_uid != os.getuid():
            raise PermissionError(errno.EPERM, "it belongs to another user", str(path))
        return file.read(most)  # it may have grown meanwhile


def read_text(path: Path, *, follow: bool = False) -> str:
    """Return the text of a regular file, as by `read_regular`, in which what is not UTF-8 is replaced.

    Raises:
        OSError: as by `read_regular`.
    """
    return read_regular(path, MOST_TEXT, follow=follow).decode(errors="replace")


def _irregular(path: Path) -> OSError:
    return OSError(errno.EINVAL, "it is not a regular file, but a FIFO, a socket or a device", str(path))
