"""Read the contents of a recording's gzip file in pieces, within the limits of a recording."""

from __future__ import annotations

import struct
import zlib
from typing import BinaryIO, Final

from glue.errors import GlueError
from glue.types import PREFIX_SIZE, body_size, has_beside

GZIP: Final = 31  # zlib's number for "with gzip's header and checksum"
_PIECE: Final = 2**16  # bytes read, and unpacked, at a time
_LENGTH: Final = struct.Struct("<I")


class TrajectoryError(GlueError):
    """A recording cannot be read or written; the message says where it goes wrong."""


class Torn(Exception):
    """The file ended before its gzip stream did."""


class Unpacked:
    """The contents of a gzip file, read member by member in pieces of known length."""

    def __init__(self, file: BinaryIO, name: str) -> None:
        self._file = file
        self._name = name
        self._packed = b""
        self._gzip = zlib.decompressobj(GZIP)
        self._bytes = bytearray()
        self._at = 0  # offset of the next byte, in self._bytes
        self._gone = 0  # number of bytes before self._bytes

    def next_member(self, magic: bytes) -> bool:
        """Begin the next gzip stream of the file, which must begin with `magic`; False if there is none."""
        self._packed = self._packed or self._file.read(_PIECE)
        if self.offset and not self._packed:
            return False
        self._gzip = zlib.decompressobj(GZIP)
        try:
            found = self.take(len(magic))
        except Torn:
            found = b""
        if found != magic:
            raise self.malformed(f"it does not unpack to {magic.decode()} and records")
        return True

    def at_end(self) -> bool:
        """Return whether this member has been read to its end."""
        return self._at == len(self._bytes) and not self._unpack()

    def take(self, size: int) -> bytes:
        """Return the next `size` bytes.

        Raises:
            TrajectoryError: the member ends before that.
            Torn: the file ends before that.
        """
        self._fill(size)
        self._at += size
        return bytes(self._bytes[self._at - size : self._at])

    def body(self, limit: int) -> bytes:
        """Return the next abstract type's body, of at most `limit` bytes."""
        self._fill(PREFIX_SIZE)
        try:
            size = body_size(self._bytes, self._at)
        except GlueError as error:
            raise self.malformed(str(error)) from None
        if size > limit:
            raise self.malformed(f"an observation or action of {size} bytes; {limit} are allowed")
        return self.take(size)

    def action(self, limit: int) -> bytes:
        """Return the next abstract type's body like `body`, of an action."""
        body = self.body(limit)
        if has_beside(body):
            raise self.malformed("an action with a mask or extras, which only an observation can have")
        return body

    def text(self, limit: int) -> str:
        """Return the next length and text, of at most `limit` bytes."""
        (size,) = _LENGTH.unpack(self.take(_LENGTH.size))
        if size > limit:
            raise self.malformed(f"a text of {size} bytes; {limit} are allowed")
        try:
            return self.take(size).decode()
        except UnicodeDecodeError:
            raise self.malformed("a text that is not UTF-8") from None

    @property
    def offset(self) -> int:
        """Number of unpacked bytes taken so far."""
        return self._gone + self._at

    def malformed(self, what: str) -> TrajectoryError:
        """Return the error that says what is wrong, and where."""
        return TrajectoryError(
            f"{self._name} cannot be read as a recording: {what} "
            f"(before byte {self.offset} of what it unpacks to)"
        )

    def _fill(self, size: int) -> None:
        """Unpack until the next `size` bytes are in memory."""
        while len(self._bytes) - self._at < size:
            if not self._unpack():
                raise self.malformed("it ends inside a record")

    def _unpack(self) -> bool:
        """Unpack at least one more byte; return False if the member has ended."""
        while not self._gzip.eof:
            if not self._packed:
                self._packed = self._file.read(_PIECE)
                if not self._packed:
                    raise Torn
            try:
                piece = self._gzip.decompress(self._packed, _PIECE)
            except zlib.error as error:
                raise self.malformed(f"gzip cannot unpack it ({error})") from None
            self._packed = self._gzip.unused_data if self._gzip.eof else self._gzip.unconsumed_tail
            if piece:
                del self._bytes[: self._at]
                self._gone += self._at
                self._at = 0
                self._bytes += piece
                return True
        return False
