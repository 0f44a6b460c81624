"""Signatures made with a CURVE key pair, which can be checked with the public key of a hub.

A secret key of Curve25519 signs as the Ed25519 key with the same x-coordinate; the sign of the point is
fixed. A signature is 64 bytes, and is checked like any other Ed25519 signature.

Source: T. Perrin, The XEdDSA and VXEdDSA Signature Schemes, revision 1, 2016 (XEd25519).
"""

from __future__ import annotations

from typing import Final

from glue.installed import needing
from glue.system import chance

with needing("keys", "signatures need PyNaCl"):
    from nacl.bindings import (
        crypto_core_ed25519_scalar_add,
        crypto_core_ed25519_scalar_mul,
        crypto_core_ed25519_scalar_negate,
        crypto_core_ed25519_scalar_reduce,
        crypto_hash_sha512,
        crypto_scalarmult_ed25519_base_noclamp,
        crypto_sign_open,
    )
    from nacl.exceptions import CryptoError

_PRIME: Final = 2**255 - 19
_SIGN_BIT: Final = 0x80
_HASH_1: Final = b"\xfe" + 31 * b"\xff"
"""Prefix that separates the hash of a signature's nonce from all other hashes."""


def sign(secret: bytes, message: bytes) -> bytes:
    """Return the signature of a message, 64 bytes.

    Args:
        secret: the secret key of a CURVE pair, 32 bytes.
        message: any bytes.
    """
    clamped = bytes([secret[0] & 248, *secret[1:31], secret[31] & 127 | 64])
    scalar = bytes(crypto_core_ed25519_scalar_reduce(clamped + bytes(32)))
    point = crypto_scalarmult_ed25519_base_noclamp(scalar)
    if point[31] & _SIGN_BIT:
        scalar = crypto_core_ed25519_scalar_negate(scalar)
        point = bytes([*point[:31], point[31] & ~_SIGN_BIT])
    nonce = crypto_core_ed25519_scalar_reduce(
        crypto_hash_sha512(_HASH_1 + scalar + message + chance.random_bytes(64))
    )
    commitment = crypto_scalarmult_ed25519_base_noclamp(nonce)
    challenge = crypto_core_ed25519_scalar_reduce(crypto_hash_sha512(commitment + point + message))
    answer = crypto_core_ed25519_scalar_add(nonce, crypto_core_ed25519_scalar_mul(challenge, scalar))
    return bytes(commitment + answer)


def is_signed(public: bytes, message: bytes, signature: bytes) -> bool:
    """Return whether a signature of a message was made with the secret key of a pair.

    Args:
        public: the public key of the pair, 32 bytes.
        message: the message.
        signature: the signature, from an untrusted source: any length.
    """
    u = int.from_bytes(public, "little")
    if len(signature) != 64 or u >= _PRIME - 1:
        return False
    y = (u - 1) * pow(u + 1, -1, _PRIME) % _PRIME
    try:
        return bool(crypto_sign_open(signature + message, y.to_bytes(32, "little")) == message)
    except CryptoError:
        return False
