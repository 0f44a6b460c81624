"""CURVE, ZeroMQ's mechanism for authentication and encryption, without I/O: both ends of one connection.

Each side has a long-term key pair, C of the client and S of the server, and makes a short-term pair for the
connection, C' and S'. The client knows S in advance, and the server checks whether it knows C:

    client                                             server
    HELLO     C', Box[64 zeros](C'->S)          ─────▶
              ◀─────  WELCOME   Box[S', cookie](S->C')
    INITIATE  cookie, Box[C, vouch, metadata](C'->S')  ─────▶
              ◀─────  READY     Box[metadata](S'->C')
    MESSAGE   Box[flags, payload](C'->S') and back

The vouch is Box[C', S](C->S'): only the owner of C's secret key can make it, for this connection and this
server.

Between WELCOME and INITIATE the server keeps neither C' nor its own s': both are in the cookie, whose key is
made for this connection only and forgotten when the cookie returns. A HELLO or INITIATE recorded from another
connection therefore opens nothing here.

A server refuses a handshake with ERROR: in answer to HELLO, because the client expects a different public key
of this server; in answer to INITIATE, because the server does not know the client's key. libzmq's server
closes the connection in the first case.

Source: ZeroMQ RFC 26 (CurveZMQ), RFC 25 (ZMTP CURVE), and libzmq 4.3, whose MESSAGE is not a command of ZMTP
and carries the flags of its frame in the box.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import Final, NamedTuple

from glue.errors import RemoteProtocolError
from glue.installed import needing
from glue.system import chance
from glue.wire.zmtp import LONG_HEAD, MORE, SHORT_HEAD, HandshakeRefused, head

with needing("keys", "keys need PyNaCl"):
    from nacl._sodium import ffi, lib
    from nacl.bindings import (
        crypto_box_beforenm,
        crypto_box_easy_afternm,
        crypto_box_open_easy_afternm,
        crypto_scalarmult_base,
        crypto_secretbox,
        crypto_secretbox_open,
    )
    from nacl.exceptions import CryptoError

_KEY: Final = 32
_ZEROS: Final = bytes(64)
_PADDING: Final = bytes(72)
_VERSION: Final = b"\x01\x00"

_HELLO: Final = struct.Struct("6s2s72s32s8s80s")
_INITIATE: Final = struct.Struct("9s96s8s")
_LEAST_BOX: Final = 16 + _KEY + 96
"""Size of INITIATE's box without metadata, in bytes: its authenticator, C and the vouch."""

_WELCOME: Final = struct.Struct("8s16s144s")
_READY: Final = struct.Struct("6s8s")

_IGNORED_BIT: Final = 0x80
"""Bit of the last byte of a public key that Curve25519 ignores; no box protects it, and no key has it set."""

_MESSAGE: Final = b"\x07MESSAGE"
_MAC: Final = 16
"""Overhead of a box over its content, in bytes."""

_BUFFER: Final = 4096
"""Size in bytes of the buffer in which a connection seals and opens boxes."""

_MAX_BUFFERED: Final = _BUFFER - 512
"""Maximum size of a body to be sealed and of a message to be opened there: a typical observation fits."""

_LAST_AT: Final = 256
"""Where the last of two boxes is opened in the buffer, behind the first one."""

_FLAGS: Final = [bytes((flags,)) for flags in range(256)]
_NONCE_AT: Final = len(_MESSAGE)
_BOX_AT: Final = _NONCE_AT + 8
_LEAST_MESSAGE: Final = _BOX_AT + _MAC + 1
"""Size of a MESSAGE without payload, in bytes: its name, its nonce, and the box of its flags."""

_ERROR_400: Final = b"\x05ERROR\x03400"
"""Body of the ERROR that libzmq's monitor reports as a failed authentication."""

_NONCE: Final = struct.Struct(">Q")

_UNSEALED: Final = struct.Struct(">Q16xB")
"""A MESSAGE between its name and the frame in it: its nonce, the authenticator of its box, and the flags."""

_BOX_NONCE: Final = struct.Struct(">16sQ")
"""The nonce of a box: a prefix, and the number that its message has in its place."""

_seal: Final = lib.crypto_box_easy_afternm
_open: Final = lib.crypto_box_open_easy_afternm


class _Layout(NamedTuple):
    """The bytes of a message of two frames, each in a MESSAGE.

    `start` and `middle` are the bytes before the two nonces, and `last_box` is the offset of the last box.
    `pack_into` packs `start`, a nonce, flags, a frame, and the same again, leaving room for authenticators;
    `unpack` unpacks `start`, a nonce, a box, and the same again.
    """

    size: int
    last_box: int
    start: bytes
    middle: bytes
    pack_into: Callable[..., None]
    unpack: Callable[[bytes], tuple[bytes, ...]]


@lru_cache(1024)
def _layout(size: int, last_size: int) -> _Layout:
    """Return the layout of a message by the sizes of its frames."""
    start, middle = (head(0, frame + _LEAST_MESSAGE) + _MESSAGE for frame in (size, last_size))
    unsealed = struct.Struct(f">{len(start)}sQ16xB{size}s{len(middle)}sQ16xB{last_size}s")
    box, last_box = _MAC + 1 + size, _MAC + 1 + last_size
    sealed = struct.Struct(f">{len(start)}s8s{box}s{len(middle)}s8s{last_box}s")
    return _Layout(sealed.size, sealed.size - last_box, start, middle, unsealed.pack_into, sealed.unpack)


@lru_cache(1024)
def _layout_of(first: int, whole: int) -> _Layout | None:
    """Return the layout of `whole` bytes of which the second is `first`; None if there is none."""
    size = first - _LEAST_MESSAGE
    for last_head in (SHORT_HEAD, LONG_HEAD):
        last_size = whole - SHORT_HEAD.size - first - last_head.size - _LEAST_MESSAGE
        if size >= 0 and last_size >= 0 and (layout := _layout(size, last_size)).size == whole:
            return layout
    return None


def public_key(secret: bytes) -> bytes:
    """Return the public key, 32 bytes, of a secret key."""
    key: bytes = crypto_scalarmult_base(secret)
    return key


def _short_term_pair() -> tuple[bytes, bytes]:
    secret = chance.random_bytes(_KEY)
    return public_key(secret), secret


class _Curve:
    """One end of one connection.

    Boxes are sealed in their message, and opened in one buffer. `nacl.bindings` allocates memory and checks
    the key for every box, which takes longer than the encryption, and copies large boxes three times.

    Args:
        own: the name of this end in nonces, "C" for the client or "S" for the server.
        other: the name of the other end.
    """

    overhead: Final = _LEAST_MESSAGE
    """Overhead of the frame of a MESSAGE over the frame in it, in bytes."""

    def __init__(self, own: bytes, other: bytes) -> None:
        self._key = b""  # of C' and S', 32 bytes once it is known
        self._received = bytes(8)  # the number in the other end's latest nonce, big-endian
        self._sent = 0
        self._prefix = b"CurveZMQMESSAGE" + own
        self._other_prefix = b"CurveZMQMESSAGE" + other

    def _agree(self, key: bytes) -> None:
        """Set the key of C' and S', and make room to open boxes: strangers do not come this far."""
        self._key = key
        self._buffer = ffi.new("unsigned char[]", _BUFFER)
        self._view = ffi.buffer(self._buffer)
        self._last_opened = self._buffer + _LAST_AT
        self._first_box = self._buffer + (SHORT_HEAD.size + _BOX_AT)
        self._first_content = self._first_box + _MAC

    def decrypt(self, frame: bytes) -> tuple[int, bytes]:
        """Return the flags and the payload of a MESSAGE.

        Raises:
            RemoteProtocolError: the frame is not a MESSAGE of this connection, or its nonce is not greater
                than all earlier ones.
        """
        if len(frame) < _LEAST_MESSAGE or not frame.startswith(_MESSAGE):
            raise RemoteProtocolError("it sent something that is not encrypted")
        nonce = frame[_NONCE_AT:_BOX_AT]
        self._count(nonce)
        size = len(frame) - _BOX_AT
        opened = self._buffer if size <= _MAX_BUFFERED else ffi.new("unsigned char[]", size)
        box = ffi.from_buffer(frame) + _BOX_AT
        if _open(opened, box, size, self._other_prefix + nonce, self._key):
            raise RemoteProtocolError("it sent a message that was not encrypted for this connection")
        content = ffi.buffer(opened, size - _MAC)
        return content[0][0], content[1:]

    def open_message(self, data: bytes) -> tuple[bytes, bytes] | None:
        """Return the frames, without encryption, of the message of two frames that `data` is.

        Return None if it is anything else, or in doubt; then nothing has changed, and `decrypt` decides.
        """
        layout = _layout_of(data[1], len(data)) if 1 < len(data) <= _MAX_BUFFERED else None
        if layout is None:
            return None
        start, nonce, box, middle, last_nonce, last_box = layout.unpack(data)
        if start != layout.start or middle != layout.middle or not self._received < nonce < last_nonce:
            return None
        view, key, prefix = self._view, self._key, self._other_prefix
        size, last_size = len(box), len(last_box)
        if (
            _open(self._buffer, box, size, prefix + nonce, key)
            or view[0] != _FLAGS[MORE]
            or _open(self._last_opened, last_box, last_size, prefix + last_nonce, key)
            or view[_LAST_AT] != _FLAGS[0]
        ):
            return None
        self._received = last_nonce
        return view[1 : size - _MAC], view[_LAST_AT + 1 : _LAST_AT + last_size - _MAC]

    def seal_message(self, header: bytes, body: bytes) -> bytes | bytearray:
        """Return the bytes of a message of two frames, the first of at most 222 bytes."""
        size, last_size = len(header), len(body)
        if last_size > _MAX_BUFFERED:
            return self.encode((header, body))
        whole, last_box_at, start, middle, pack_into, _ = _layout(size, last_size)
        view, key, prefix = self._view, self._key, self._prefix
        box, last_box = self._first_box, self._buffer + last_box_at
        self._sent = sent = self._sent + 2
        pack_into(view, 0, start, sent - 1, MORE, header, middle, sent, 0, body)
        _seal(box, self._first_content, 1 + size, _BOX_NONCE.pack(prefix, sent - 1), key)
        _seal(last_box, last_box + _MAC, 1 + last_size, _BOX_NONCE.pack(prefix, sent), key)
        message: bytes = view[:whole]
        return message

    def encode(self, frames: Sequence[bytes], flags: int = 0) -> bytearray:
        """Return the bytes of a message of at least one frame, the last of which has these flags."""
        parts: list[bytes] = []
        boxes: list[tuple[int, int, bytes]] = []  # where each begins, the size of its content, and its nonce
        at, left, sent = 0, len(frames), self._sent
        for frame in frames:
            left -= 1
            sent += 1
            size = len(frame) + _LEAST_MESSAGE
            start = head(0, size) + _MESSAGE
            parts += start, _UNSEALED.pack(sent, MORE if left else flags), frame
            boxes.append((at + len(start) + _NONCE.size, 1 + len(frame), _BOX_NONCE.pack(self._prefix, sent)))
            at += len(start) + size - len(_MESSAGE)
        self._sent = sent
        # Sealed in place: of a large message, the only copy is the one that is sent.
        message = bytearray().join(parts)
        begin, key = ffi.from_buffer(message), self._key
        for at, size, nonce in boxes:
            _seal(begin + at, begin + (at + _MAC), size, nonce, key)
        return message

    def _count(self, nonce: bytes) -> None:
        if nonce <= self._received:
            raise RemoteProtocolError("it used a nonce that is not greater than the one before: a replay?")
        self._received = nonce

    def _next_nonce(self) -> bytes:
        self._sent += 1
        return _NONCE.pack(self._sent)


class CurveServer(_Curve):
    """The server's end of one connection.

    Args:
        secret: the server's long-term secret key s, 32 bytes.
        knows: takes a client's long-term public key C, 32 bytes; returns whether the client is admitted.

    Attributes:
        client: the client's long-term public key; empty until its INITIATE has been accepted.
    """

    is_server: Final = True

    def __init__(self, secret: bytes, knows: Callable[[bytes], bool]) -> None:
        super().__init__(b"S", b"C")
        self.client: bytes = b""
        self._secret = secret
        self._knows = knows
        self._cookie_key = b""
        self._greeted = False

    def begin(self) -> bytes:
        """Return b"": the client begins."""
        return b""

    def answer(self, command: bytes, metadata: bytes) -> tuple[bytes, bytes | None]:
        """Return the body of the answer to a command, and the client's metadata after INITIATE.

        Args:
            command: the body of the client's command.
            metadata: the server's metadata, for READY.

        Raises:
            HandshakeRefused: the client is unknown, or expects a different public key of this server.
            RemoteProtocolError: the command is malformed, out of place, or not made for this connection.
        """
        try:
            if not self._greeted:
                self._greeted = True
                return self._welcome(command), None
            return self._ready(command, metadata)
        except CryptoError:
            raise RemoteProtocolError("inconsistent CURVE handshake") from None

    def _welcome(self, command: bytes) -> bytes:
        if len(command) != _HELLO.size:
            raise RemoteProtocolError("it did not begin the CURVE handshake with HELLO")
        name, version, padding, short_term, nonce, box = _HELLO.unpack(command)
        if (name, version, padding) != (b"\x05HELLO", _VERSION, _PADDING):
            raise RemoteProtocolError("it did not begin the CURVE handshake with a HELLO of version 1.0")
        if short_term[-1] & _IGNORED_BIT:
            raise RemoteProtocolError("its short-term key was changed on its way")
        self._count(nonce)
        shared = crypto_box_beforenm(short_term, self._secret)
        try:
            zeros = crypto_box_open_easy_afternm(box, b"CurveZMQHELLO---" + nonce, shared)
        except CryptoError:
            reason = "it expects a different public key for this hub"
            raise HandshakeRefused(reason, _ERROR_400) from None
        if zeros != _ZEROS:
            raise RemoteProtocolError("its HELLO is malformed")
        public, secret = _short_term_pair()
        self._cookie_key = chance.random_bytes(_KEY)
        nonce = chance.random_bytes(16)
        cookie = nonce + crypto_secretbox(short_term + secret, b"COOKIE--" + nonce, self._cookie_key)
        nonce = chance.random_bytes(16)
        welcome: bytes = crypto_box_easy_afternm(public + cookie, b"WELCOME-" + nonce, shared)
        return b"\x07WELCOME" + nonce + welcome

    def _ready(self, command: bytes, metadata: bytes) -> tuple[bytes, bytes]:
        if len(command) < _INITIATE.size + _LEAST_BOX or not command.startswith(b"\x08INITIATE"):
            raise RemoteProtocolError("it did not answer WELCOME with INITIATE")
        _, cookie, nonce = _INITIATE.unpack_from(command)
        cookie_key, self._cookie_key = self._cookie_key, b""
        kept = crypto_secretbox_open(cookie[16:], b"COOKIE--" + cookie[:16], cookie_key)
        short_term, secret = kept[:_KEY], kept[_KEY:]
        self._count(nonce)
        shared = crypto_box_beforenm(short_term, secret)
        opened: bytes = crypto_box_open_easy_afternm(
            command[_INITIATE.size :], b"CurveZMQINITIATE" + nonce, shared
        )
        client, vouch_nonce, vouch = opened[:_KEY], opened[_KEY : _KEY + 16], opened[_KEY + 16 : _KEY + 96]
        vouched = crypto_box_open_easy_afternm(
            vouch, b"VOUCH---" + vouch_nonce, crypto_box_beforenm(client, secret)
        )
        if vouched != short_term + public_key(self._secret):
            raise RemoteProtocolError("its vouch is for another connection or another server")
        if not self._knows(client):
            raise HandshakeRefused("its key is not allowed here", _ERROR_400)
        self.client = client
        self._agree(shared)
        nonce = self._next_nonce()
        ready: bytes = crypto_box_easy_afternm(metadata, b"CurveZMQREADY---" + nonce, shared)
        return b"\x05READY" + nonce + ready, opened[_KEY + 96 :]


class CurveClient(_Curve):
    """The client's end of one connection.

    Args:
        public: the client's long-term public key C, 32 bytes.
        secret: its long-term secret key c, 32 bytes.
        server: the server's long-term public key S, 32 bytes.
    """

    is_server: Final = False

    def __init__(self, public: bytes, secret: bytes, server: bytes) -> None:
        super().__init__(b"C", b"S")
        self._public = public
        self._secret = secret
        self._server = server
        self._short_public, self._short_secret = _short_term_pair()

    def begin(self) -> bytes:
        """Return the body of HELLO."""
        nonce = self._next_nonce()
        key = crypto_box_beforenm(self._server, self._short_secret)
        box = crypto_box_easy_afternm(_ZEROS, b"CurveZMQHELLO---" + nonce, key)
        return _HELLO.pack(b"\x05HELLO", _VERSION, _PADDING, self._short_public, nonce, box)

    def answer(self, command: bytes, metadata: bytes) -> tuple[bytes, bytes | None]:
        """Return INITIATE in answer to WELCOME, or b"" and the server's metadata in answer to READY.

        Args:
            command: the body of the server's command.
            metadata: the client's metadata, for INITIATE.

        Raises:
            RemoteProtocolError: the command is malformed, out of place, or not made by the owner of S.
        """
        try:
            return (
                self._take_ready(command) if self.server_known else (self._initiate(command, metadata), None)
            )
        except CryptoError:
            raise RemoteProtocolError("inconsistent CURVE handshake") from None

    @property
    def server_known(self) -> bool:
        """Whether the server has proved that it has the secret key of S."""
        return bool(self._key)

    def _initiate(self, command: bytes, metadata: bytes) -> bytes:
        if len(command) != _WELCOME.size or not command.startswith(b"\x07WELCOME"):
            raise RemoteProtocolError("it did not answer HELLO with WELCOME")
        _, nonce, box = _WELCOME.unpack(command)
        shared = crypto_box_beforenm(self._server, self._short_secret)
        opened = crypto_box_open_easy_afternm(box, b"WELCOME-" + nonce, shared)
        partner, cookie = opened[:_KEY], opened[_KEY:]
        self._agree(crypto_box_beforenm(partner, self._short_secret))
        nonce = chance.random_bytes(16)
        vouched = self._short_public + self._server
        key = crypto_box_beforenm(partner, self._secret)
        vouch = nonce + crypto_box_easy_afternm(vouched, b"VOUCH---" + nonce, key)
        nonce = self._next_nonce()
        content = self._public + vouch + metadata
        box = crypto_box_easy_afternm(content, b"CurveZMQINITIATE" + nonce, self._key)
        initiate: bytes = _INITIATE.pack(b"\x08INITIATE", cookie, nonce) + box
        return initiate

    def _take_ready(self, command: bytes) -> tuple[bytes, bytes]:
        if len(command) < _READY.size + _MAC or not command.startswith(b"\x05READY"):
            raise RemoteProtocolError("it did not answer INITIATE with READY")
        _, nonce = _READY.unpack_from(command)
        self._count(nonce)
        box = command[_READY.size :]
        return b"", crypto_box_open_easy_afternm(box, b"CurveZMQREADY---" + nonce, self._key)
