"""Saved agents and environments as bytes, and back. Not pickled: only numbers, and arrays of numbers.

    offset  0   8 bytes    magic, GLUEAGNT
    offset  8   uint32     version of this format, 1
    offset 12   uint32     H, bytes of header
    offset 16   H bytes    JSON: agent, settings, numbers, and [name, dtype, count] of every array
    then        arrays     one after another, nothing in between
    at the end  32 bytes   SHA-256 of all before it

Everything is little-endian, and equal contents give equal bytes. The magic and the field names date from when
only agents could be saved; `agent` is the name of the agent or environment.
"""

from __future__ import annotations

import hashlib
import json
import struct
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from glue.errors import SaveError

_MAGIC: Final = b"GLUEAGNT"
_VERSION: Final = 1
_HEAD: Final = struct.Struct("<8sII")
_DIGEST_SIZE: Final = hashlib.sha256().digest_size
_MAX_HEADER: Final = 1 << 16
_MAX_SIZE: Final = 1 << 30
_DTYPES: Final = frozenset({"<u8", "<i8", "<f8", "|i1"})

_GENERATOR: Final = struct.Struct("<16s16sII")

GENERATOR_SIZE: Final = _GENERATOR.size
"""Bytes of a saved generator: state and increment of 128 bits, a flag, and a spare 32-bit number."""

Setting = int | float | str | bool
Arrays = Mapping[str, npt.NDArray[Any]]


@dataclass(frozen=True, slots=True)
class Saved:
    """The saved state of an agent or environment.

    Attributes:
        player: its name.
        settings: the options that the numbers and arrays depend on.
        numbers: generator state and counters, 0 to 2**64 - 1.
        arrays: one-dimensional arrays of uint64, int64, float64 or int8.
    """

    player: str
    settings: Mapping[str, Setting]
    numbers: Mapping[str, int]
    arrays: Arrays

    def number(self, name: str, high: int = 2**63 - 1) -> int:
        """Return a number by name.

        Raises:
            SaveError: the number is missing or above `high`.
        """
        number = self.numbers.get(name)
        if number is None or number > high:
            raise SaveError(f"saved {self.player}: {name} must be from 0 to {high}, not {number}")
        return number

    def array(
        self, name: str, dtype: type[np.generic], low: float = -np.inf, high: float = np.inf
    ) -> npt.NDArray[Any]:
        """Return an array by name. Floats are always finite.

        Raises:
            SaveError: the array is missing or of another type, or an element is not from `low` to `high`.
        """
        array = self.arrays.get(name)
        if array is None or array.dtype != dtype:
            raise SaveError(f"saved {self.player}: the array {name!r} of {np.dtype(dtype)} is missing")
        if not np.all(np.isfinite(array) & (array >= low) & (array <= high)):
            raise SaveError(
                f"saved {self.player}: {name!r} must have finite elements from {low:g} to {high:g}"
            )
        return array

    def generator(self) -> np.random.Generator:
        """Return the random generator that was saved by `generator_array` as the array `generator`.

        Raises:
            SaveError: the array is missing or has an impossible state.
        """
        return load_generator(self.array("generator", np.int8).tobytes())


def pack(saved: Saved) -> bytes:
    """Return a saved state as bytes."""
    arrays = {
        name: array.astype(array.dtype.newbyteorder("<"), copy=False)
        for name, array in sorted(saved.arrays.items())
    }
    header = json.dumps(
        {
            "agent": saved.player,
            "settings": dict(saved.settings),
            "numbers": dict(saved.numbers),
            "arrays": [[name, array.dtype.str, len(array)] for name, array in arrays.items()],
        },
        sort_keys=True,
    ).encode()
    head = _HEAD.pack(_MAGIC, _VERSION, len(header))
    data = b"".join((head, header, *(array.tobytes() for array in arrays.values())))
    return data + hashlib.sha256(data).digest()


def unpack(data: bytes, player: str, settings: Mapping[str, Setting]) -> Saved:
    """Return the state packed by `pack`, for a player of this name and these settings.

    Raises:
        SaveError: `data` is too long, damaged, or of another version, player or settings.
    """
    if len(data) > _MAX_SIZE:
        raise SaveError(f"a save has at most {_MAX_SIZE} bytes; received {len(data)}")
    if len(data) < _HEAD.size + _DIGEST_SIZE or not is_packed(data):
        raise SaveError(f"these {len(data)} bytes are not a save of {player}: they do not begin like one")
    _, version, header_size = _HEAD.unpack_from(data)
    if version != _VERSION:
        raise SaveError(f"this save is of format {version}; only format {_VERSION} can be read")
    contents, digest = data[:-_DIGEST_SIZE], data[-_DIGEST_SIZE:]
    if hashlib.sha256(contents).digest() != digest:
        raise SaveError("this save is damaged: its digest does not match its contents")
    if header_size > _MAX_HEADER:
        raise SaveError(f"the header of a save has at most {_MAX_HEADER} bytes; received {header_size}")
    try:
        saved = _read(contents[_HEAD.size :], header_size)
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError) as error:
        raise SaveError(f"this save is not well formed: {error!s:.200}") from None
    if saved.player != player:
        raise SaveError(f"this was saved by {saved.player!r:.80}, and cannot be loaded by {player}")
    if saved.settings != settings:
        options = ", ".join(f"{name}={value}" for name, value in sorted(saved.settings.items()))
        raise SaveError(
            f"{player} was saved with the options {options:.200}: load it into one started with the same"
        )
    return saved


def is_packed(data: bytes) -> bool:
    """Return whether `data` begins like the result of `pack`; some players used to be saved differently."""
    return data.startswith(_MAGIC)


def generator_array(generator: np.random.Generator) -> npt.NDArray[np.int8]:
    """Return the state of a random generator as an array to save under the name `generator`."""
    return np.frombuffer(save_generator(generator), np.int8)


def pack_generator(player: str, generator: np.random.Generator) -> bytes:
    """Return the save of a player whose only state is its random generator."""
    return pack(Saved(player, {}, {}, {"generator": generator_array(generator)}))


def unpack_generator(data: bytes, player: str) -> np.random.Generator:
    """Return the generator that `pack_generator` packed, or that an older version saved without packing it.

    Raises:
        SaveError: `data` is damaged, or of another player.
    """
    return unpack(data, player, {}).generator() if is_packed(data) else load_generator(data)


def _read(contents: bytes, header_size: int) -> Saved:
    """Return the state in a header and its arrays; any error means that they are not well formed."""
    header = json.loads(contents[:header_size])
    arrays: dict[str, npt.NDArray[Any]] = {}
    offset = header_size
    for name, dtype, count in header["arrays"]:
        if (
            name in arrays
            or dtype not in _DTYPES
            or type(count) is not int
            or not 0 <= count <= len(contents)
        ):
            raise ValueError(f"array {name!r} of {count!r} {dtype!r}")
        arrays[str(name)] = np.frombuffer(contents, dtype, count, offset).copy()
        offset += arrays[str(name)].nbytes
    if offset != len(contents):
        raise ValueError(f"{len(contents) - offset} bytes after its arrays")
    numbers: dict[str, int] = header["numbers"]
    for name, number in numbers.items():
        if type(number) is not int or not 0 <= number < 2**64:
            raise ValueError(f"number {name!r} is {number!r}")
    return Saved(str(header["agent"]), dict(header["settings"]), numbers, arrays)


def save_generator(generator: np.random.Generator) -> bytes:
    """Return the state of a generator made by `np.random.default_rng` (PCG64)."""
    state = generator.bit_generator.state
    inner = state["state"]
    return _GENERATOR.pack(
        inner["state"].to_bytes(16, "little"),
        inner["inc"].to_bytes(16, "little"),
        state["has_uint32"],
        state["uinteger"],
    )


def load_generator(data: bytes) -> np.random.Generator:
    """Return the generator that `save_generator` saved.

    Raises:
        SaveError: `data` does not have GENERATOR_SIZE bytes, or is not the state of a generator.
    """
    if len(data) != GENERATOR_SIZE:
        raise SaveError(f"a saved generator has {GENERATOR_SIZE} bytes; received {len(data)}")
    state, increment, has_uint32, uinteger = _GENERATOR.unpack(data)
    if has_uint32 > 1 or increment[0] % 2 == 0:
        raise SaveError("a saved generator is damaged: its state is not one of PCG64")
    bits = np.random.PCG64()
    bits.state = {
        "bit_generator": "PCG64",
        "state": {"state": int.from_bytes(state, "little"), "inc": int.from_bytes(increment, "little")},
        "has_uint32": has_uint32,
        "uinteger": uinteger,
    }
    return np.random.Generator(bits)
