"""Signatures with CURVE keys, checked by libsodium like any other Ed25519 signature."""

from __future__ import annotations

import numpy as np
import pytest

nacl = pytest.importorskip("nacl.bindings", reason="needs the extra keys")

from glue.keys.signing import is_signed, sign  # noqa: E402

MESSAGE = b"the standings"


@pytest.mark.parametrize("seed", range(20))
def test_only_the_pair_and_the_message_fit(seed: int) -> None:
    """For half of all keys, the sign of the point is changed."""
    secret = np.random.default_rng(seed).bytes(32)
    public = nacl.crypto_scalarmult_base(secret)
    other = nacl.crypto_scalarmult_base(bytes(reversed(secret)))
    signature = sign(secret, MESSAGE)
    assert is_signed(public, MESSAGE, signature)
    assert not is_signed(public, MESSAGE + b".", signature)
    assert not is_signed(other, MESSAGE, signature)
    assert not is_signed(public, MESSAGE, bytes([signature[0] ^ 1]) + signature[1:])
    assert not is_signed(public, MESSAGE, signature[:-1] + bytes([signature[-1] ^ 1]))


@pytest.mark.parametrize("signature", [b"", bytes(63), bytes(64), bytes(65), b"\xff" * 64])
@pytest.mark.parametrize(
    "public", [bytes(32), b"\x01" + bytes(31), b"\xff" * 32, b"\xec" + b"\xff" * 30 + b"\x7f"]
)
def test_no_bytes_make_it_fail(public: bytes, signature: bytes) -> None:
    assert not is_signed(public, MESSAGE, signature)
