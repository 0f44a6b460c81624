"""The image that an entrant has uploaded: check it, and load it into the engine without its names.

    python -P -m experiment_runner.competition.season.images BYTES DIR < FILE

FILE is a tar of `docker save`, BYTES the size that its image may have, and DIR the season's directory. The
result is a line of JSON: `id` of the image, or `error`. It is a separate process, with little memory: a
stranger wrote the file. Images that are no longer played are removed from the engine first.

The engine would load whatever is in such a file: several images, under any name, so that one of this machine
would mean another image afterwards; a layer that is small and unpacks to terabytes; a sparse file. So it gets
a new tar, with one image that has no name, of which every byte and file has been counted. What an engine
might read differently is refused, so that both count the same.
"""

from __future__ import annotations

import errno
import gzip
import io
import json
import platform
import posixpath
import re
import resource
import sys
import tarfile
import tempfile
import zlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from datetime import timedelta
from itertools import takewhile
from pathlib import Path
from typing import IO, Any, BinaryIO, Final, cast

from experiment_runner.competition.course import course_of
from experiment_runner.competition.jail import check_image
from experiment_runner.competition.launching import name_of_run
from experiment_runner.competition.records.journal import utc_now
from glue.console import one_line
from glue.errors import ConfigError, GlueError

MODULE: Final = "experiment_runner.competition.season.images"

_MEMORY: Final = 2**31
"""Bytes of address space of the process."""

_MANIFEST: Final = "manifest.json"
_NO_CONFIG: Final = "its configuration is not that of an image"
_MOST_MEMBERS: Final = 1_000
_MOST_LAYERS: Final = 127  # of Docker's engine
_MOST_JSON: Final = 2**22
_MOST_SHOWN: Final = 300

_BLOCK: Final = 4096
"""Bytes that a file or folder takes at least."""

_NEW_SECONDS: Final = 3600.0
"""Age until which an image that is not played stays in the engine: it may be about to be played."""

_PIECE: Final = 2**16
_GZIP: Final = b"\x1f\x8b"
_COMPRESSED: Final = (
    *(_GZIP, b"BZh", b"\xfd7zXZ", b"\x28\xb5\x2f\xfd", b"\x04\x22\x4d\x18"),
    *(bytes([first]) + b"\x2a\x4d\x18" for first in range(0x50, 0x60)),  # what decoders of zstd skip
)
"""First bytes of the compressions that engines know; only one layer of gzip is counted here."""

_UNIT: Final = 512
_HEADER: Final = re.compile(
    rb"(.{100}).{24}([0-7]{11})[\0 ].{20}([0-6xLK]).{100}"
    rb"ustar(?:\0.{82}(.{155})\0{12}|  \0.{80}\0{167})",
    re.DOTALL,
)
"""A header of a layer: the member's name, size and kind, and the folder of its name.

Of what tars may have, this is what all programs read alike. It excludes sparse files, global headers, kinds
that have data for one program and none for another, and sizes in other forms, such as those of 8 GiB or more.
"""

_EXTENSIONS: Final = (b"x", b"L", b"K", b"LK", b"KL")
"""Kinds of headers that may come before another: PAX's, or GNU's long name and long target of a link."""

_AMBIGUOUS: Final = (
    "it is no tar, or has a sparse file, a global header or another that programs read differently"
)

_RECORD: Final = re.compile(rb"([0-9]{1,7}) ([^=]+)=")
_SIZES: Final = (b"size", b"GNU.sparse.")
"""Prefixes of the keys with which PAX changes a size."""

_COPIED: Final = b".wh..wh.plnk"
"""A folder of AUFS: engines make a copy, not a link, of every hard link to a file in it."""

_WRONG: Final = (
    *(tarfile.TarError, zlib.error, EOFError, OSError),
    *(ValueError, OverflowError, MemoryError, RecursionError),
)
"""Errors of a file that is not what it should be."""

_FULL: Final = (errno.ENOSPC, errno.EDQUOT)

_ARCHITECTURES: Final = {"x86_64": "amd64", "aarch64": "arm64"}
"""Docker's names of the processors that Python names otherwise."""


class UnfitImage(ConfigError):
    """A file holds no image that can be loaded; the message says why."""


def copy_image(source: BinaryIO, target: BinaryIO, most: int) -> None:
    """Copy the image in a tar of `docker save` to another tar, without its names.

    Args:
        source: the tar, from an untrusted source; it can seek.
        target: receives the copy.
        most: maximum size of the image in bytes, unpacked.

    Raises:
        UnfitImage: it holds no image, or one that is too large or cannot be jailed.
    """
    with _named("the file"), tarfile.open(fileobj=source, mode="r:") as archive:
        members = _members(archive)
        found = _json(archive, members, _MANIFEST)
        if not isinstance(found, list) or len(found) != 1 or not isinstance(found[0], dict):
            raise UnfitImage("the file does not hold one image with one tag: give docker save one NAME:TAG")
        name, layers = found[0].get("Config"), found[0].get("Layers")
        if not isinstance(name, str) or not isinstance(layers, list) or len(layers) > _MOST_LAYERS:
            raise UnfitImage(f"its {_MANIFEST} is not that of an image with up to {_MOST_LAYERS} layers")
        _check_config(_json(archive, members, name))
        left = most
        with tarfile.open(fileobj=target, mode="w") as copy:
            names = [f"{number}.tar" for number in range(len(layers))]
            for layer, file in zip(layers, names, strict=True):
                member = _member(members, layer)
                left -= _unpacked(_file(archive, member), left, most)
                _add(copy, file, member.size, _file(archive, member))
            # The bytes of the configuration are the image's id.
            own = json.dumps([{"Config": "config.json", "RepoTags": None, "Layers": names}]).encode()
            for file, data in (("config.json", _content(archive, members, name)), (_MANIFEST, own)):
                _add(copy, file, len(data), io.BytesIO(data))


def _check_config(found: object) -> None:
    config = _folded(found)
    settings = _folded(config.get("config"))
    wanted = _ARCHITECTURES.get(platform.machine(), platform.machine())
    system, processor = config.get("os"), config.get("architecture")
    if (system, processor) != ("linux", wanted):
        raise UnfitImage(
            f"the image is for {one_line(f'{system}/{processor}', 40)}, and this machine is linux/{wanted}: "
            f"build it for the platform linux/{wanted}"
        )
    if not isinstance(settings.get("volumes") or {}, dict):
        raise UnfitImage(_NO_CONFIG)
    check_image("uploaded", {key.capitalize(): value for key, value in settings.items()}, 0)


def _folded(found: object) -> dict[str, Any]:
    """Return an object of a configuration with its keys in lower case: engines take them in any."""
    if not isinstance(found, dict):
        raise UnfitImage(_NO_CONFIG)
    folded = {key.casefold(): value for key, value in found.items()}
    if len(folded) < len(found):
        raise UnfitImage("its configuration has two keys that differ in case alone")
    return folded


def _members(archive: tarfile.TarFile) -> dict[str, tarfile.TarInfo]:
    """Return the members of a tar by their names."""
    members: dict[str, tarfile.TarInfo] = {}
    for count, member in enumerate(archive, 1):
        if count > _MOST_MEMBERS:
            raise UnfitImage(f"the file has more than {_MOST_MEMBERS:,} parts")
        members[posixpath.normpath(member.name)] = member
    return members


def _member(members: Mapping[str, tarfile.TarInfo], name: object) -> tarfile.TarInfo:
    """Return a file of a tar; Docker writes a link in place of a layer that is there already."""
    path = posixpath.normpath(str(name))
    found = members.get(path)
    if found is not None and (found.issym() or found.islnk()):
        folder = posixpath.dirname(path) if found.issym() else ""
        found = members.get(posixpath.normpath(posixpath.join(folder, found.linkname)))
    if found is None or not found.isreg() or found.issparse():
        hint = "; it should be a tar of docker save" if name == _MANIFEST else ""
        raise UnfitImage(f"the file has no {one_line(str(name), 80)}{hint}")
    return found


def _file(archive: tarfile.TarFile, member: tarfile.TarInfo) -> IO[bytes]:
    file = archive.extractfile(member)
    assert file is not None
    return file


def _content(archive: tarfile.TarFile, members: Mapping[str, tarfile.TarInfo], name: str) -> bytes:
    member = _member(members, name)
    if member.size > _MOST_JSON:
        raise UnfitImage(f"its {one_line(name, 80)} has more than {_MOST_JSON:,} bytes")
    return _file(archive, member).read()


def _json(archive: tarfile.TarFile, members: Mapping[str, tarfile.TarInfo], name: str) -> Any:
    try:
        return json.loads(_content(archive, members, name), object_pairs_hook=_once)
    except (ValueError, RecursionError):
        raise UnfitImage(f"its {one_line(name, 80)} is not JSON, or has a key twice") from None


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """Return an object in which each key is there once: an engine may take any of them, or join them."""
    found = dict(pairs)
    if len(found) < len(pairs):
        raise ValueError
    return found


def _unpacked(layer: IO[bytes], left: int, most: int) -> int:
    """Return the bytes that a layer takes when it is unpacked.

    Raises:
        UnfitImage: they are more than `left`.
    """
    with _named("a layer"):
        packed = layer.read(len(_GZIP)) == _GZIP
        layer.seek(0)
        plain = cast("IO[bytes]", gzip.GzipFile(fileobj=layer)) if packed else layer
        content = _Bounded(plain, left, most)
        total = 0
        before: list[bytes] = []
        for path, size in _files(content):
            # The engine makes the folders that are missing, too.
            parts = posixpath.normpath(path).split(b"/")
            shared = [*takewhile(lambda pair: pair[0] == pair[1], zip(before, parts, strict=False))]
            total += _BLOCK * max(1, len(parts) - len(shared)) + size
            content.check(total)
            before = parts
        while content.read(_PIECE):
            pass  # the engine unpacks and keeps what follows the tar, too
        return max(total, content.count)


def _files(content: _Bounded) -> Iterator[tuple[bytes, int]]:
    """Yield the path and the size of each member of a layer.

    Raises:
        ValueError: it is no tar, or has something that programs read differently.
        EOFError: it ends too early.
    """
    path, extensions = b"", b""
    block = content.read(_UNIT)
    if block.startswith(_COMPRESSED):
        raise ValueError("it is compressed, and not by gzip alone")
    while block and block != bytes(_UNIT):
        header = _HEADER.fullmatch(block)
        if header is None or _COPIED in block:
            raise ValueError(_AMBIGUOUS)
        name, digits, kind, folder = header.groups()
        size = int(digits, 8) if kind in b"0xLK" else 0
        if kind in b"xLK":
            extensions += kind
            data = content.read(size)
            if len(data) < size or extensions not in _EXTENSIONS or _COPIED in data:
                raise ValueError(_AMBIGUOUS)
            content.skip(-size % _UNIT)
            if kind == b"x":
                path = _path_of(data)
            elif kind == b"L":
                path = _text(data)
        else:
            yield path or b"/".join(filter(None, (_text(folder or b""), _text(name)))), size
            path, extensions = b"", b""
            content.skip(size + -size % _UNIT)
        block = content.read(_UNIT)


def _text(field: bytes) -> bytes:
    return field.partition(b"\0")[0]


def _path_of(records: bytes) -> bytes:
    """Return the path that a header of PAX gives to its member; empty if it gives none.

    Raises:
        ValueError: it changes the size, or is not as PAX has it.
    """
    path = b""
    at = 0
    while at < len(records):
        found = _RECORD.match(records, at)
        end = at + int(found[1]) if found else 0
        if not found or not found.end() < end <= len(records) or found[2].startswith(_SIZES):
            raise ValueError(_AMBIGUOUS)
        if found[2] == b"path":
            path = records[found.end() : end - 1]
        at = end
    return path


class _Bounded:
    """The first `left` bytes of a file; reading on raises `UnfitImage`, which names `most`.

    Attributes:
        count: number of bytes that were read.
    """

    def __init__(self, file: IO[bytes], left: int, most: int) -> None:
        self._file = file
        self._left = left
        self._most = most
        self.count = 0

    def read(self, size: int) -> bytes:
        """Return `size` bytes, or fewer at the end; no more than a piece."""
        data = self._file.read(min(size, _PIECE))
        self.count += len(data)
        self.check(self.count)
        return data

    def skip(self, size: int) -> None:
        """Read `size` bytes.

        Raises:
            EOFError: there are fewer.
        """
        while size:
            data = self.read(size)
            if not data:
                raise EOFError("it ends too early")
            size -= len(data)

    def check(self, count: int) -> None:
        """Check a number of bytes."""
        if count > self._left:
            raise UnfitImage(
                f"the image is too large: unpacked it takes more than {self._most / 2**20:g} MiB"
            )


def _add(copy: tarfile.TarFile, name: str, size: int, content: IO[bytes]) -> None:
    member = tarfile.TarInfo(name)
    member.size = size
    copy.addfile(member, content)


@contextmanager
def _named(what: str) -> Iterator[None]:
    """Turn the errors of a file that is not what it should be into `UnfitImage`."""
    try:
        yield
    except _WRONG as error:
        if isinstance(error, OSError) and error.errno in _FULL:
            raise
        why = one_line(str(error), _MOST_SHOWN) or type(error).__name__
        raise UnfitImage(f"{what} is not as docker save writes it: {why}") from None


def remove_others(directory: Path) -> None:
    """Remove a season's images that are no longer played from the engine.

    Raises:
        ConfigError: there is no engine, or no client of it.
        ExperimentError: the season cannot be read, or the engine cannot remove them.
    """
    from experiment_runner.competition.containers import Containers

    until = utc_now() - timedelta(seconds=_NEW_SECONDS)
    Containers().tidy(_repository(directory), course_of(directory).images, until)


def _repository(directory: Path) -> str:
    return f"glue-season/{name_of_run(directory)}"


def main() -> None:
    """Check and load the file at the standard input."""
    most, directory = sys.argv[1:]
    resource.setrlimit(resource.RLIMIT_AS, (_MEMORY, _MEMORY))
    try:
        with tempfile.TemporaryFile(dir=directory) as copy:
            copy_image(sys.stdin.buffer, copy, int(most))
            from experiment_runner.competition.containers import Containers  # needs an extra

            copy.seek(0)
            with suppress(GlueError):
                remove_others(Path(directory))
            found = {"id": Containers().load(copy, _repository(Path(directory)))}
    except GlueError as error:
        found = {"error": str(error)}
    except OSError as error:  # not of the image
        sys.exit(f"cannot check an image: {error}")
    print(json.dumps(found))


if __name__ == "__main__":
    main()
