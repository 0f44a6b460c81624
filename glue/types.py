"""Observation and Action: RL-Glue's abstract type.

Both are three sequences of numbers: ints (int32), doubles (float64), chars (bytes). A value is kept
as the bytes that cross the wire, its *body*, so that sending and comparing cost nothing and the NumPy
arrays are read-only views. An observation may carry two things beside the three sequences: a mask of the
legal actions, and extras, named values that no agent sees (`glue.extras`).

    offset  0        uint32   number of ints I
    offset  4        uint32   number of doubles D
    offset  8        uint32   number of chars C
    offset 12        uint16   size of the mask in bytes M
    offset 14        uint16   size of the extras in bytes X
    offset 16        D float64, then I int32, then C bytes, M bytes, X bytes, without gaps

Everything is little-endian. Doubles come first so that they are aligned. The mask has a bit for each value of
each int of an action, in this order: bit i is bit i % 8 of byte i // 8, and is set if the value is legal.
Source of the type: RL-Glue 3.0, rl_abstract_type_t.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from contextlib import suppress
from functools import lru_cache
from typing import Any, Final, NamedTuple, Self

import numpy as np
import numpy.typing as npt

from glue.errors import LocalProtocolError, RemoteProtocolError
from glue.extras import Extra, GivenExtra, pack_extras, unpack_extras

CUT_OFF: Final = 2
"""The terminal, on the wire, of a step that cut the episode off: true, but the state is not terminal."""

IntArray = npt.NDArray[np.int32]
DoubleArray = npt.NDArray[np.float64]
BoolArray = npt.NDArray[np.bool_]
Mask = Sequence[bool] | npt.NDArray[np.bool_ | np.integer]

PREFIX_SIZE: Final = 16
BESIDE_AT: Final = 12
NOTHING_BESIDE: Final = bytes(4)
"""Bytes of a body without mask and extras, from the offset `BESIDE_AT` on."""

MAX_MASK_BITS: Final = 8 * (2**16 - 1)
"""Maximum number of values of all ints of an action together that a mask can tell of."""

_PREFIX: Final = struct.Struct("<4I")
_BESIDE: Final = struct.Struct("<2H")
_FEW_BITS: Final = 256
"""Maximum number of bits of a mask whose packed and unpacked forms are cached."""

_INT32: Final = np.dtype("<i4")
_FLOAT64: Final = np.dtype("<f8")
_INT32_MIN: Final = -(2**31)
_INT32_MAX: Final = 2**31 - 1


class AbstractType:
    """Three sequences of numbers; immutable, hashable, compared bit by bit.

    Args:
        ints: whole numbers from -2**31 to 2**31 - 1.
        doubles: numbers; infinities and NaN are allowed and keep their bits.
        chars: bytes.
        mask: only for an `Observation`, like `extras`.

    Raises:
        LocalProtocolError: an int is not a whole number of 32 bits, a double is not a number of 64 bits, or
            one of the three is not a one-dimensional sequence of these.

    Two values are equal when their bytes are: 0.0 differs from -0.0, and a NaN equals itself.
    """

    __slots__ = ("_body", "_doubles", "_ints")

    _body: bytes
    _ints: IntArray | None
    _doubles: DoubleArray | None

    def __init__(
        self,
        ints: Sequence[int] | npt.NDArray[np.integer] = (),
        doubles: Sequence[float] | npt.NDArray[np.floating] = (),
        chars: bytes = b"",
        *,
        mask: Mask | None = None,
        extras: Mapping[str, GivenExtra] | None = None,
    ) -> None:
        if not isinstance(chars, bytes):
            raise LocalProtocolError(f"chars must be bytes, not {chars!r:.80}")
        sizes, beside = 0, b""
        if mask is not None or extras:
            sizes, beside = self._beside(mask, extras)
        try:
            prefix = _PREFIX.pack(len(ints), len(doubles), len(chars), sizes)
        except TypeError:
            raise LocalProtocolError(_not_rows(ints, doubles)) from None
        self._body = b"".join((prefix, _pack_doubles(doubles), _pack_ints(ints), chars, beside))
        self._ints = None
        self._doubles = None

    def _beside(self, mask: Mask | None, extras: Mapping[str, GivenExtra] | None) -> tuple[int, bytes]:
        """Return the bytes of a mask and extras, and the fourth word of the body, which has their sizes."""
        raise LocalProtocolError("only an observation has a mask or extras")

    @classmethod
    def from_body(cls, body: bytes) -> Self:
        """Return the value with the wire form `body`, without copying it.

        Raises:
            RemoteProtocolError: the counts do not add up to the length of `body`, or an action has a mask or
                extras.
        """
        size = body_size(body)
        if size != len(body):
            raise RemoteProtocolError(
                f"the counts of an abstract type add up to {size} bytes; its body has {len(body)}"
            )
        if cls is Action and has_beside(body):
            raise RemoteProtocolError("bytes 12 to 15 of an action must be zero: it has no mask, no extras")
        return cls._wrap(body)

    @classmethod
    def _wrap(cls, body: bytes) -> Self:
        value = cls.__new__(cls)
        value._body = body
        value._ints = None
        value._doubles = None
        return value

    @property
    def body(self) -> bytes:
        """The wire form, described at the top of this module."""
        return self._body

    @property
    def ints(self) -> IntArray:
        """The ints, shape (I,), int32, read-only."""
        if self._ints is None:
            ints, doubles, _, _ = _PREFIX.unpack_from(self._body)
            self._ints = np.frombuffer(self._body, _INT32, ints, PREFIX_SIZE + 8 * doubles)
        return self._ints

    @property
    def doubles(self) -> DoubleArray:
        """The doubles, shape (D,), float64, read-only."""
        if self._doubles is None:
            doubles = _PREFIX.unpack_from(self._body)[1]
            self._doubles = np.frombuffer(self._body, _FLOAT64, doubles, PREFIX_SIZE)
        return self._doubles

    @property
    def chars(self) -> bytes:
        """The chars, C bytes."""
        ints, doubles, chars, _ = _PREFIX.unpack_from(self._body)
        at = PREFIX_SIZE + 8 * doubles + 4 * ints
        return self._body[at : at + chars]

    @property
    def counts(self) -> tuple[int, int, int]:
        """Number of ints, doubles and chars."""
        ints, doubles, chars, _ = _PREFIX.unpack_from(self._body)
        return ints, doubles, chars

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, AbstractType):
            return NotImplemented
        return self._body == other._body and type(self) is type(other)

    def __hash__(self) -> int:
        return hash(self._body)

    def __repr__(self) -> str:
        parts = []
        for name, values in (("ints", self.ints), ("doubles", self.doubles)):
            if len(values):
                shown = ", ".join(map(repr, values[:8].tolist())) + (", ..." if len(values) > 8 else "")
                parts.append(f"{name}=[{shown}]")
        chars = self.chars
        if chars:
            parts.append(f"chars={chars[:32]!r}" + ("..." if len(chars) > 32 else ""))
        return f"{type(self).__name__}({', '.join(parts)})"

    def __reduce__(self) -> tuple[object, tuple[bytes]]:
        return type(self).from_body, (self._body,)


class Observation(AbstractType):
    """An observation of an environment; see `AbstractType`.

    Args:
        ints: as for `AbstractType`, like `doubles` and `chars`.
        mask: whether each value of each int of an action is legal, shape (bits,): for two ints from 0 to 3
            and from 1 to 2, the values 0, 1, 2, 3 of the first, then 1, 2 of the second. None if all are.
            Only an environment with the capability `mask` may give one.
        extras: values by name for everyone but the agent; see `glue.extras`. Only an environment with the
            capability `extras` may give any.

    Raises:
        LocalProtocolError: as for `AbstractType`; the mask is no sequence of truth values or has more than
            `MAX_MASK_BITS`; an extra is of another type, or they exceed a limit.
    """

    __slots__ = ("_mask_values",)

    _mask_values: int
    """Number of truth values of the mask; only set where the observation was made of one."""

    def _beside(self, mask: Mask | None, extras: Mapping[str, GivenExtra] | None) -> tuple[int, bytes]:
        bits = b""
        if mask is not None:
            bits = _pack_mask(mask)
            self._mask_values = len(mask)
        named = pack_extras(extras) if extras else b""
        return len(bits) | len(named) << 16, bits + named

    @property
    def packed_mask(self) -> bytes:
        """The mask as it crosses the wire, M bytes; empty if every action is legal."""
        body = self._body
        mask, extras = _BESIDE.unpack_from(body, BESIDE_AT)
        end = len(body) - extras
        return body[end - mask : end]

    @property
    def mask(self) -> BoolArray | None:
        """Whether each value of an action is legal, shape (8 * M,), read-only; None if every action is.

        The bits after those of the task spec's values are False. See `glue.taskspec.legal_values`.
        """
        packed = self.packed_mask
        return _unpack_mask(packed) if packed else None

    @property
    def extras(self) -> dict[str, Extra]:
        """The extras, by name; empty if there are none.

        Raises:
            RemoteProtocolError: the environment has sent something else.
        """
        extras = beside_sizes(self._body)[1]
        return unpack_extras(self._body[-extras:]) if extras else {}

    def without(self, *, mask: bool = False, extras: bool = True) -> Observation:
        """Return this observation without its mask, or without its extras."""
        body = without_beside(self._body, mask=mask, extras=extras)
        return self if body is self._body else Observation._wrap(body)

    def __repr__(self) -> str:
        shown = super().__repr__()
        if not has_beside(self._body):
            return shown
        mask, extras = beside_sizes(self._body)
        parts = [f"mask=0x{self.packed_mask[:8].hex()}" + ("..." if mask > 8 else "")] if mask else []
        parts += [f"extras of {extras} bytes"] if extras else []
        return f"{shown[:-1]}{', ' * (shown[-2] != '(')}{', '.join(parts)})"


class Action(AbstractType):
    """An action of an agent; see `AbstractType`."""

    __slots__ = ()


def body_size(buffer: bytes | bytearray, offset: int = 0) -> int:
    """Return the size in bytes of the abstract type that starts at `offset`, according to its counts.

    Raises:
        RemoteProtocolError: fewer than 16 bytes are left.
    """
    if len(buffer) - offset < PREFIX_SIZE:
        raise RemoteProtocolError(
            f"an abstract type starts with {PREFIX_SIZE} bytes of counts; {len(buffer) - offset} are left"
        )
    ints, doubles, chars, beside = _PREFIX.unpack_from(buffer, offset)
    return int(PREFIX_SIZE + 8 * doubles + 4 * ints + chars + (beside & 0xFFFF) + (beside >> 16))


def beside_sizes(body: bytes) -> tuple[int, int]:
    """Return the sizes in bytes of the mask and of the extras of a body."""
    mask, extras = _BESIDE.unpack_from(body, BESIDE_AT)
    return mask, extras


def has_beside(body: bytes, offset: int = 0) -> bool:
    """Return whether the body that starts at `offset` has a mask or extras."""
    return not body.startswith(NOTHING_BESIDE, offset + BESIDE_AT)


def without_beside(body: bytes, *, mask: bool, extras: bool) -> bytes:
    """Return the body of an observation without its mask, or without its extras."""
    masked, extra = beside_sizes(body)
    if not (mask and masked) and not (extras and extra):
        return body
    end = len(body) - extra
    sizes = _BESIDE.pack(0 if mask else masked, 0 if extras else extra)
    numbers = body[PREFIX_SIZE : end - masked if mask else end]
    return b"".join((body[:BESIDE_AT], sizes, numbers, body[end:] if not extras else b""))


def _pack_mask(mask: Mask) -> bytes:
    bits = b""
    try:
        if len(mask) <= MAX_MASK_BITS:
            bits = bytes(mask) if isinstance(mask, (list, tuple)) else _mask_bytes(np.asarray(mask))
    except (TypeError, ValueError):
        with suppress(TypeError, ValueError):  # a list of NumPy's truth values
            bits = _mask_bytes(np.asarray(mask))
    return (_packed_bits if len(bits) <= _FEW_BITS else _packed_bits.__wrapped__)(bits)


def _mask_bytes(mask: npt.NDArray[Any]) -> bytes:
    if mask.ndim != 1 or mask.dtype.kind not in "biu":
        return b""
    return mask.tobytes() if mask.dtype.itemsize == 1 else bytes(mask.tolist())


@lru_cache(maxsize=1024)
def _packed_bits(bits: bytes) -> bytes:
    """Return the packed form of a mask with a byte for each bit."""
    values = np.frombuffer(bits, np.uint8)
    if not 0 < len(values) <= MAX_MASK_BITS or values.max() > 1:
        raise LocalProtocolError(
            f"a mask has a truth value for each value of each int of an action, 1 to {MAX_MASK_BITS} of them"
        )
    return np.packbits(values, bitorder="little").tobytes()


def _unpack_mask(packed: bytes) -> BoolArray:
    return (_unpacked_bits if 8 * len(packed) <= _FEW_BITS else _unpacked_bits.__wrapped__)(packed)


@lru_cache(maxsize=1024)
def _unpacked_bits(packed: bytes) -> BoolArray:
    bits = np.unpackbits(np.frombuffer(packed, np.uint8), bitorder="little").view(np.bool_)
    bits.flags.writeable = False
    return bits


@lru_cache(maxsize=256)
def _run_of(letter: str, count: int) -> struct.Struct:
    return struct.Struct(f"<{count}{letter}")


def _pack_ints(values: Sequence[int] | npt.NDArray[np.integer]) -> bytes:
    if isinstance(values, np.ndarray):
        return _one_row("ints", _int_array(values))
    try:
        return _run_of("i", len(values)).pack(*values)
    except struct.error as error:
        wrong = next((f"number {i} is {v!r}" for i, v in enumerate(values) if not _fits_int32(v)), str(error))
        raise LocalProtocolError(
            f"ints must be whole numbers from {_INT32_MIN} to {_INT32_MAX}; {wrong}"
        ) from None


def _fits_int32(value: object) -> bool:
    return isinstance(value, (int, np.integer)) and _INT32_MIN <= int(value) <= _INT32_MAX


def _int_array(values: npt.NDArray[np.integer]) -> IntArray:
    if values.dtype == _INT32:
        return values.astype(_INT32, copy=False)
    if values.dtype.kind not in "iub":
        raise LocalProtocolError(f"ints must be whole numbers, not an array of {values.dtype}")
    if values.size and (int(values.min()) < _INT32_MIN or int(values.max()) > _INT32_MAX):
        raise LocalProtocolError(
            f"ints must be from {_INT32_MIN} to {_INT32_MAX}; the array spans "
            f"{values.min()} to {values.max()}"
        )
    return values.astype(_INT32)


def _pack_doubles(values: Sequence[float] | npt.NDArray[np.floating]) -> bytes:
    if isinstance(values, np.ndarray):
        if values.dtype.kind not in "fiub":
            raise LocalProtocolError(f"doubles must be numbers, not an array of {values.dtype}")
        return _one_row("doubles", values.astype(_FLOAT64, copy=False))
    try:
        return _run_of("d", len(values)).pack(*values)
    except (struct.error, OverflowError):
        wrong = next(f"number {i} is {v!r:.80}" for i, v in enumerate(values) if not _fits_double(v))
        raise LocalProtocolError(f"doubles must be numbers of 64 bits; {wrong}") from None


def _fits_double(value: object) -> bool:
    try:
        struct.pack("<d", value)
    except (struct.error, OverflowError):
        return False
    return True


def _one_row(name: str, values: IntArray | DoubleArray) -> bytes:
    if values.ndim != 1:
        raise LocalProtocolError(f"{name} must have one dimension, not the shape {values.shape}")
    return values.tobytes()


def _not_rows(ints: object, doubles: object) -> str:
    return f"ints and doubles must be sequences of numbers, not {ints!r:.80} and {doubles!r:.80}"


class Step(NamedTuple):
    """The result of a step, as environments return it and experiments receive it.

    Attributes:
        reward: the reward of the action that was executed.
        observation: the observation after it.
        terminal: whether the episode is over.
        truncated: whether the episode is over only because it was cut off, in a state that is not terminal.
            The agent then receives the observation by agent_step, so that it can learn from its value;
            agent_end is not called, and the episode is not counted.
        action: the agent's next action, from `rl_step`; after a terminal step the action just executed, after
            a truncated one an action that is not executed. Empty in steps without an agent.
    """

    reward: float
    observation: Observation
    terminal: bool
    truncated: bool = False
    action: Action = Action()


_TRUTH: Final = (int, np.bool_, np.integer)
"""Types that `terminal` may have: RL-Glue's own was an int, and a bool is an int."""


_NO_ACTION: Final = Step._field_defaults["action"]
_step: Final = tuple.__new__
"""Constructor of a named tuple, at half the cost of calling its class."""


def arrays_of(value: AbstractType) -> dict[str, npt.NDArray[Any]]:
    """Return the three sequences of a value as arrays, by the names `ints`, `doubles` and `chars`."""
    return {"ints": value.ints, "doubles": value.doubles, "chars": np.frombuffer(value.chars, np.uint8)}


def step_of(answer: Any) -> Step:
    """Return the result of an `env_step` as a `Step` whose `truncated` implies `terminal`.

    Raises:
        TypeError, ValueError: the answer is not the result of a step.
    """
    if type(answer) is Step:
        reward, observation, terminal, truncated, _ = answer
        if type(reward) is float and type(terminal) is bool and truncated is False:
            return answer  # the usual case
    else:
        reward, observation, terminal = answer
        if terminal is False and type(reward) is float:
            return _step(Step, (reward, observation, False, False, _NO_ACTION))  # the usual case
        truncated = type(terminal) is int and terminal == CUT_OFF
    if not isinstance(terminal, _TRUTH):
        raise TypeError(f"terminal is True or False, not {terminal!r}")
    return Step(float(reward), observation, bool(terminal or truncated), bool(truncated))
