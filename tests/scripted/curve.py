"""The client's end of CURVE, written from RFC 26 only: unlike libzmq's, it can be made to misbehave."""

from __future__ import annotations

import os
import struct
from dataclasses import dataclass, field

from nacl.bindings import crypto_box_afternm, crypto_box_beforenm, crypto_box_keypair, crypto_box_open_afternm

GREETING = b"\xff" + bytes(8) + b"\x7f\x03\x01" + b"CURVE".ljust(20, b"\0") + bytes(32)
METADATA = b"\x0bSocket-Type\x00\x00\x00\x06DEALER"


@dataclass(frozen=True)
class Pair:
    """A key pair."""

    public: bytes
    secret: bytes

    @classmethod
    def new(cls) -> Pair:
        return cls(*crypto_box_keypair())


def command(body: bytes) -> bytes:
    """Return a ZMTP command."""
    if len(body) < 256:
        return bytes((4, len(body))) + body
    return b"\x06" + struct.pack(">Q", len(body)) + body


def _seal(plain: bytes, nonce: bytes, key: bytes) -> bytes:
    sealed: bytes = crypto_box_afternm(plain, nonce, key)
    return sealed


def _open(sealed: bytes, nonce: bytes, key: bytes) -> bytes:
    opened: bytes = crypto_box_open_afternm(sealed, nonce, key)
    return opened


@dataclass
class CurveClient:
    """The client of one connection.

    Args:
        own: its long-term keys.
        server: the server's long-term public key.
        short: its keys for this connection.
        number: number of the latest nonce.
    """

    own: Pair
    server: bytes
    short: Pair = field(default_factory=Pair.new)
    number: int = 0

    def hello(self, zeros: bytes = bytes(64), version: bytes = b"\x01\x00") -> bytes:
        """Return the body of HELLO."""
        nonce = self._nonce()
        box = _seal(zeros, b"CurveZMQHELLO---" + nonce, crypto_box_beforenm(self.server, self.short.secret))
        return b"\x05HELLO" + version + bytes(72) + self.short.public + nonce + box

    def welcome(self, body: bytes) -> None:
        """Take the body of WELCOME."""
        assert body.startswith(b"\x07WELCOME")
        assert len(body) == 168
        key = crypto_box_beforenm(self.server, self.short.secret)
        opened = _open(body[24:], b"WELCOME-" + body[8:24], key)
        self.partner, self.cookie = opened[:32], opened[32:]
        self.key = crypto_box_beforenm(self.partner, self.short.secret)

    def initiate(
        self,
        metadata: bytes = METADATA,
        vouched: bytes | None = None,
        claimed: bytes | None = None,
        cookie: bytes | None = None,
    ) -> bytes:
        """Return the body of INITIATE; its parts can be replaced."""
        nonce = os.urandom(16)
        vouch = nonce + _seal(
            self.short.public + self.server if vouched is None else vouched,
            b"VOUCH---" + nonce,
            crypto_box_beforenm(self.partner, self.own.secret),
        )
        nonce = self._nonce()
        plain = (claimed or self.own.public) + vouch + metadata
        box = _seal(plain, b"CurveZMQINITIATE" + nonce, self.key)
        return b"\x08INITIATE" + (cookie or self.cookie) + nonce + box

    def ready(self, body: bytes) -> bytes:
        """Take the body of READY; return the server's metadata."""
        assert body.startswith(b"\x05READY")
        return _open(body[14:], b"CurveZMQREADY---" + body[6:14], self.key)

    def message(self, payload: bytes, flags: int = 0) -> bytes:
        """Return a frame that holds an encrypted frame."""
        nonce = self._nonce()
        body = (
            b"\x07MESSAGE" + nonce + _seal(bytes((flags,)) + payload, b"CurveZMQMESSAGEC" + nonce, self.key)
        )
        return (bytes((0, len(body))) if len(body) < 256 else b"\2" + struct.pack(">Q", len(body))) + body

    def read(self, body: bytes) -> tuple[int, bytes]:
        """Return the flags and the payload of the server's encrypted frame."""
        assert body.startswith(b"\x07MESSAGE")
        opened = _open(body[16:], b"CurveZMQMESSAGES" + body[8:16], self.key)
        return opened[0], opened[1:]

    def _nonce(self) -> bytes:
        self.number += 1
        return struct.pack(">Q", self.number)
