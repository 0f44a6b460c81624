"""CURVE, the mechanism by which ZeroMQ authenticates and encrypts, without I/O: the server's end.

Each side has a long-term key pair, C of the client and S of the server, and makes a short-term pair for the
connection, C' and S'. The client knows S beforehand, and the server decides whether it knows C:

    client                                             server
    HELLO     C', Box[64 zeros](C'->S)          ─────▶
              ◀─────  WELCOME   Box[S', cookie](S->C')
    INITIATE  cookie, Box[C, vouch, metadata](C'->S')  ─────▶
              ◀─────  READY     Box[metadata](S'->C')
    MESSAGE   Box[flags, payload](C'->S') and back

The vouch is Box[C', S](C->S'): only who has C's secret key can make it, for this connection and this server.

Between WELCOME and INITIATE the server keeps neither C' nor its own s': both are in the cookie, whose key is
made for this one connection and forgotten when the cookie comes back. So whatever was recorded of another
connection, a HELLO, an INITIATE or all of it, opens nothing here.

Source: ZeroMQ RFC 26 (CurveZMQ), RFC 25 (ZMTP CURVE), and libzmq 4.3, whose MESSAGE is not a command of ZMTP
and carries the flags of its frame in the box.
"""

from __future__ import annotations

import os
import struct
from collections.abc import Callable, Sequence
from typing import Final

from glue.errors import ConfigError, RemoteProtocolError
from glue.protocol.zmtp import HandshakeRefused

try:
    from nacl.bindings import (
        crypto_box_afternm,
        crypto_box_beforenm,
        crypto_box_keypair,
        crypto_box_open_afternm,
        crypto_scalarmult_base,
        crypto_secretbox,
        crypto_secretbox_open,
    )
    from nacl.exceptions import CryptoError
except ImportError:
    raise ConfigError("a hub with --keys needs PyNaCl: pip install 'glue-rl[keys]'") from None

__all__ = ["CurveServer", "public_key"]

_KEY: Final = 32
_ZEROS: Final = bytes(64)
_PADDING: Final = bytes(72)
_VERSION: Final = b"\x01\x00"

_HELLO: Final = struct.Struct("6s2s72s32s8s80s")
_INITIATE: Final = struct.Struct("9s96s8s")
_LEAST_BOX: Final = 16 + _KEY + 96
"""Bytes of INITIATE's box without metadata: its authenticator, C and the vouch."""

_IGNORED_BIT: Final = 0x80
"""Of the last byte of a public key: Curve25519 ignores it, so no box protects it; no key is made with it."""

_MESSAGE: Final = b"\x07MESSAGE"
_LEAST_MESSAGE: Final = len(_MESSAGE) + 8 + 16 + 1

_ERROR_400: Final = b"\x05ERROR\x03400"
"""libzmq's monitor shows it as a failed authentication."""

_NONCE: Final = struct.Struct(">Q")
_SIZE: Final = struct.Struct(">BQ")


def public_key(secret: bytes) -> bytes:
    """Return the public key, 32 bytes, that belongs to a secret one."""
    key: bytes = crypto_scalarmult_base(secret)
    return key


class CurveServer:
    """The server's end of one connection.

    Args:
        secret: the server's long-term secret key s, 32 bytes.
        knows: returns whether a client with the long-term public key C, 32 bytes, is let in.

    Attributes:
        client: the client's long-term public key; empty until its INITIATE has been accepted.
    """

    overhead: Final = _LEAST_MESSAGE
    """Bytes by which the frame of a MESSAGE is longer than the frame in it."""

    def __init__(self, secret: bytes, knows: Callable[[bytes], bool]) -> None:
        self.client = b""
        self._secret = secret
        self._knows = knows
        self._cookie_key = b""
        self._greeted = False
        self._shared = b""  # the key of C' and S'
        self._received = 0  # the number in the client's latest nonce
        self._sent = 0

    def answer(self, command: bytes, metadata: bytes) -> tuple[bytes, bytes | None]:
        """Return the body of the answer to a command of the handshake.

        With it comes the client's metadata once the handshake is complete, and None before that.

        Args:
            command: the body of the client's command.
            metadata: our own, for READY.

        Raises:
            HandshakeRefused: the client is not known.
            RemoteProtocolError: the command is malformed, out of place, or not made for this connection.
        """
        try:
            if not self._greeted:
                self._greeted = True
                return self._welcome(command), None
            return self._ready(command, metadata)
        except CryptoError:
            raise RemoteProtocolError("its CURVE handshake does not fit together") from None

    def decrypt(self, frame: bytes) -> tuple[int, bytes]:
        """Return the flags and the payload of a MESSAGE.

        Raises:
            RemoteProtocolError: it is not a MESSAGE of this connection that comes after those before.
        """
        if len(frame) < _LEAST_MESSAGE or not frame.startswith(_MESSAGE):
            raise RemoteProtocolError("it sent something that is not encrypted")
        nonce = frame[8:16]
        self._count(nonce)
        try:
            opened: bytes = crypto_box_open_afternm(frame[16:], b"CurveZMQMESSAGEC" + nonce, self._shared)
        except CryptoError:
            raise RemoteProtocolError(
                "it sent a message that was not encrypted for this connection"
            ) from None
        return opened[0], opened[1:]

    def encrypt(self, flags: int, payload: bytes) -> bytes:
        """Return the frame of a MESSAGE, its head included."""
        nonce = self._next_nonce()
        box = crypto_box_afternm(bytes((flags,)) + payload, b"CurveZMQMESSAGES" + nonce, self._shared)
        size = len(box) + 16
        head = bytes((0, size)) if size < 256 else _SIZE.pack(2, size)
        return b"".join((head, _MESSAGE, nonce, box))

    def encode(self, frames: Sequence[bytes]) -> bytes:
        """Return the bytes of a message of at least one frame."""
        last = len(frames) - 1
        return b"".join(self.encrypt(int(i < last), frame) for i, frame in enumerate(frames))

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
            zeros = crypto_box_open_afternm(box, b"CurveZMQHELLO---" + nonce, shared)
        except CryptoError:
            raise RemoteProtocolError("it takes another public key for the one of this hub") from None
        if zeros != _ZEROS:
            raise RemoteProtocolError("its HELLO is malformed")
        public, secret = crypto_box_keypair()
        self._cookie_key = os.urandom(_KEY)
        nonce = os.urandom(16)
        cookie = nonce + crypto_secretbox(short_term + secret, b"COOKIE--" + nonce, self._cookie_key)
        nonce = os.urandom(16)
        welcome: bytes = crypto_box_afternm(public + cookie, b"WELCOME-" + nonce, shared)
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
        opened: bytes = crypto_box_open_afternm(
            command[_INITIATE.size :], b"CurveZMQINITIATE" + nonce, shared
        )
        client, vouch_nonce, vouch = opened[:_KEY], opened[_KEY : _KEY + 16], opened[_KEY + 16 : _KEY + 96]
        vouched = crypto_box_open_afternm(
            vouch, b"VOUCH---" + vouch_nonce, crypto_box_beforenm(client, secret)
        )
        if vouched != short_term + public_key(self._secret):
            raise RemoteProtocolError("its vouch is for another connection or another server")
        if not self._knows(client):
            raise HandshakeRefused("its key is not allowed here", _ERROR_400)
        self.client = client
        self._shared = shared
        nonce = self._next_nonce()
        ready: bytes = crypto_box_afternm(metadata, b"CurveZMQREADY---" + nonce, shared)
        return b"\x05READY" + nonce + ready, opened[_KEY + 96 :]

    def _count(self, nonce: bytes) -> None:
        (number,) = _NONCE.unpack(nonce)
        if number <= self._received:
            raise RemoteProtocolError("it used a nonce that is not greater than the one before: a replay?")
        self._received = number

    def _next_nonce(self) -> bytes:
        self._sent += 1
        return _NONCE.pack(self._sent)
