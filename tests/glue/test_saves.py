"""Saves: packed data is unpacked unchanged, and damaged data is refused."""

from __future__ import annotations

import hashlib
import json
import struct
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from glue import saves
from glue.errors import SaveError
from glue.saves import Saved, pack, unpack

SETTINGS = {"grid": 2, "tile_above": False}
EXAMPLE = Saved(
    "tiles",
    SETTINGS,
    {"random": 2**64 - 1, "cycles": 7},
    {"keys": np.array([3, 2**63], np.uint64), "values": np.array([0.1, -0.0])},
)


def forged(header: dict[str, Any] | bytes, body: bytes = b"", version: int = 1) -> bytes:
    """Return a checkpoint with a header of our own and the right digest."""
    text = header if isinstance(header, bytes) else json.dumps(header).encode()
    contents = struct.pack("<8sII", b"GLUEAGNT", version, len(text)) + text + body
    return contents + hashlib.sha256(contents).digest()


def header(**changes: Any) -> dict[str, Any]:
    return {"agent": "tiles", "settings": SETTINGS, "numbers": {}, "arrays": [], **changes}


@given(
    numbers=st.dictionaries(st.text(max_size=5), st.integers(0, 2**64 - 1), max_size=4),
    ints=st.lists(st.integers(-(2**63), 2**63 - 1), max_size=20),
    floats=st.lists(st.floats(), max_size=20),
    small=st.lists(st.integers(-128, 127), max_size=20),
)
def test_what_is_packed_is_unpacked(
    numbers: dict[str, int], ints: list[int], floats: list[float], small: list[int]
) -> None:
    arrays = {"a": np.array(ints, np.int64), "b": np.array(floats), "c": np.array(small, np.int8)}
    data = pack(Saved("some agent", {"x": 0.1}, numbers, arrays))
    back = unpack(data, "some agent", {"x": 0.1})
    assert back.numbers == numbers
    assert {name: array.tobytes() for name, array in back.arrays.items()} == {
        name: array.tobytes() for name, array in arrays.items()
    }
    assert pack(back) == data


def test_no_changed_bit_is_believed() -> None:
    data = pack(EXAMPLE)
    for place in range(len(data)):
        broken = bytearray(data)
        broken[place] ^= 1
        with pytest.raises(SaveError):
            unpack(bytes(broken), "tiles", SETTINGS)


def test_nothing_shorter_or_longer_is_believed() -> None:
    data = pack(EXAMPLE)
    for size in range(len(data)):
        with pytest.raises(SaveError):
            unpack(data[:size], "tiles", SETTINGS)
    with pytest.raises(SaveError, match="damaged"):
        unpack(data + b"\0", "tiles", SETTINGS)


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (forged(header(), version=2), "format 2"),
        (forged(header(agent="objects-flat")), "saved by 'objects-flat', and cannot be loaded by tiles"),
        (forged(header(settings={"grid": 4})), "saved with the options grid=4"),
        (forged(b"{"), "not well formed"),
        (forged(b"[]"), "not well formed"),
        (forged(b"\xff"), "not well formed"),
        (forged(b"[" * 5000), "not well formed"),
        (forged({"agent": "tiles"}), "not well formed"),
        (forged(header(arrays=[["keys", "<u8", 2**40]])), "not well formed"),
        (forged(header(arrays=[["keys", "<u8", -1]])), "not well formed"),
        (forged(header(arrays=[["keys", "<u8", 1.5]])), "not well formed"),
        (forged(header(arrays=[["keys", "|O", 1]]), b"01234567"), "not well formed"),
        (forged(header(arrays=[["keys", ["<u8"], 1]]), b"01234567"), "not well formed"),
        (forged(header(arrays=["keys"])), "not well formed"),
        (forged(header(numbers={"random": "x"})), "not well formed"),
        (forged(header(numbers={"random": None})), "not well formed"),
        (forged(header(numbers={"random": -1})), "not well formed"),
        (forged(header(numbers={"random": 2**70})), "not well formed"),
        (forged(header(numbers={"random": float("inf")})), "not well formed"),
        (forged(header(arrays=[["keys", "<u8", 2**70]])), "not well formed"),
        (forged(header(arrays=[["keys", "<u8", 0], ["keys", "<u8", 0]])), "not well formed"),
        (forged(header(), b"more"), "4 bytes after"),
        (forged(b" " * 70_000), "at most 65536 bytes"),
    ],
)
def test_a_forgery_with_the_right_digest_is_still_checked(data: bytes, message: str) -> None:
    with pytest.raises(SaveError, match=message):
        unpack(data, "tiles", SETTINGS)


def test_a_header_longer_than_the_whole_is_refused() -> None:
    contents = struct.pack("<8sII", b"GLUEAGNT", 1, 60_000) + b"{}"
    with pytest.raises(SaveError, match="not well formed"):
        unpack(contents + hashlib.sha256(contents).digest(), "tiles", SETTINGS)


def test_too_long_a_save_is_not_even_hashed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(saves, "_MAX_SIZE", 100)
    with pytest.raises(SaveError, match=r"at most 100 bytes.*400"):
        unpack(b"GLUEAGNT" * 50, "tiles", SETTINGS)
