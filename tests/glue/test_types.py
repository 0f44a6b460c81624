"""Observation and Action: glue/types.py."""

from __future__ import annotations

import copy
import math
import pickle
import struct
from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from glue.errors import LocalProtocolError, RemoteProtocolError
from glue.types import PREFIX_SIZE, AbstractType, Action, Observation, body_size
from tests.memory import taking_less_than

INT32_MIN, INT32_MAX = -(2**31), 2**31 - 1

int_rows = st.lists(st.integers(INT32_MIN, INT32_MAX), max_size=20)
double_rows = st.lists(st.floats(), max_size=20)
char_rows = st.binary(max_size=40)
kinds = st.sampled_from([Observation, Action])
values = st.builds(lambda kind, i, d, c: kind(i, d, c), kinds, int_rows, double_rows, char_rows)

# Signalling, negative and quiet NaN with a payload, negative zero, the smallest and the largest doubles.
ODD_DOUBLES = struct.pack(
    "<6Q", 0x7FF0000000000001, 0xFFF8000000000000, 0x7FF8DEADBEEF0001, 1 << 63, 1, 0x7FEFFFFFFFFFFFFF
)


# Round trips


@given(int_rows, double_rows, char_rows)
@example([173, -173, INT32_MAX, 0, INT32_MIN], [2.0**-7, -(2.0**-7), 0.0, 0.0078125e150], b"gF? &")
def test_value_gives_back_what_it_was_made_of(ints: list[int], doubles: list[float], chars: bytes) -> None:
    value = Observation(ints, doubles, chars)
    assert value.ints.tolist() == ints
    assert struct.pack(f"<{len(doubles)}d", *value.doubles) == struct.pack(f"<{len(doubles)}d", *doubles)
    assert value.chars == chars
    assert value.counts == (len(ints), len(doubles), len(chars))


@given(values)
def test_body_reads_back_to_an_equal_value(value: AbstractType) -> None:
    back = type(value).from_body(value.body)
    assert back == value
    assert hash(back) == hash(value)
    assert back.body is value.body
    assert back.ints.tolist() == value.ints.tolist()
    assert back.doubles.tobytes() == value.doubles.tobytes()
    assert back.chars == value.chars


@given(values)
def test_value_survives_copying(value: AbstractType) -> None:
    for twin in (copy.copy(value), copy.deepcopy(value), pickle.loads(pickle.dumps(value))):
        assert twin == value
        assert type(twin) is type(value)


def test_body_is_laid_out_as_documented() -> None:
    body = Action([1, -2], [0.5], b"abc").body
    assert body == bytes.fromhex(
        "02000000 01000000 03000000 00000000"  # counts and the reserved word
        "000000000000e03f"  # 0.5
        "01000000 feffffff"  # 1, -2
        "616263"
    )
    assert body_size(body) == len(body) == PREFIX_SIZE + 8 + 2 * 4 + 3
    assert body_size(b"xyz" + body, 3) == len(body)


def test_doubles_keep_their_bits() -> None:
    array = np.frombuffer(ODD_DOUBLES, "<f8")
    assert Observation(doubles=array).doubles.tobytes() == ODD_DOUBLES


@pytest.mark.parametrize(
    ("run", "code"),
    [
        *(("ints", order + code) for order in "<>" for code in ("i1", "i2", "i4", "i8", "u1", "u4", "u8")),
        *(("doubles", code) for code in ("<f8", ">f8", "<f4", ">f2", "<i4")),
    ],
)
def test_arrays_of_any_kind_are_taken(run: str, code: str) -> None:
    array = np.array([0, 1, 100, 2], code)
    assert Action(**{run: array}) == Action(**{run: [0, 1, 100, 2]})  # type: ignore[arg-type]
    assert Action(**{run: array[::-2]}) == Action(**{run: [2, 1]})  # type: ignore[arg-type]


@given(hnp.arrays(np.int64, st.integers(0, 5), elements=st.integers(-(2**33), 2**33)))
def test_array_is_taken_or_refused_as_its_list_is(array: npt.NDArray[np.int64]) -> None:
    if all(INT32_MIN <= number <= INT32_MAX for number in array.tolist()):
        assert Action(array) == Action(array.tolist())
    else:
        for numbers in (array, array.tolist()):
            with pytest.raises(LocalProtocolError, match="ints must be"):
                Action(numbers)


def test_numpy_numbers_in_a_list_are_taken() -> None:
    value = Action([np.int64(3), np.uint8(4)], [np.float32(0.5), 2])  # type: ignore[list-item]
    assert value == Action([3, 4], [0.5, 2.0])


# Immutability


def test_arrays_cannot_be_written() -> None:
    value = Observation([1, 2], [0.5, 1.5], b"ab")
    for array in (value.ints, value.doubles):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 0
        with pytest.raises(ValueError, match="WRITEABLE"):
            array.setflags(write=True)
    assert value == Observation([1, 2], [0.5, 1.5], b"ab")


def test_value_does_not_follow_the_arrays_it_was_made_of() -> None:
    ints, doubles = np.array([1, 2], np.int32), np.array([0.5])
    value = Observation(ints, doubles)
    ints[0], doubles[0] = 9, 9.5
    assert value == Observation([1, 2], [0.5])


@pytest.mark.parametrize("name", ["ints", "doubles", "chars", "body", "counts", "note"])
def test_attributes_cannot_be_set(name: str) -> None:
    with pytest.raises(AttributeError):
        setattr(Observation([1]), name, b"")


def test_arrays_have_the_types_of_the_wire() -> None:
    value = Observation([1, 2, 3], [0.5], b"a")
    assert (value.ints.dtype, value.ints.shape) == (np.dtype("<i4"), (3,))
    assert (value.doubles.dtype, value.doubles.shape) == (np.dtype("<f8"), (1,))
    assert value.doubles.flags.aligned
    assert value.ints is value.ints
    empty = Observation()
    assert (empty.ints.shape, empty.doubles.shape, empty.chars) == ((0,), (0,), b"")


# Equality


def test_equality_is_by_bits() -> None:
    assert Observation(doubles=[0.0]) != Observation(doubles=[-0.0])
    assert Observation(doubles=[math.nan]) == Observation(doubles=[math.nan])
    one, other = (np.frombuffer(struct.pack("<Q", 0x7FF8000000000000 + n), "<f8") for n in (0, 1))
    assert Observation(doubles=one) != Observation(doubles=other)
    assert Observation([0]) != Observation([0, 0])
    # The same bytes behind the prefix, with other counts.
    assert Observation(ints=[0x61616161]) != Observation(chars=b"aaaa")


def test_observation_is_no_action() -> None:
    observation, action = Observation([1]), Action([1])
    assert observation.body == action.body
    assert observation != action
    assert observation != [1]


# Limits and mistakes


WRONG: dict[str, list[tuple[Any, str]]] = {
    "ints": [
        ([0, INT32_MAX + 1], "from -2147483648 to 2147483647; number 1 is 2147483648"),
        ([INT32_MIN - 1], "number 0 is -2147483649"),
        ([1.0], "number 0 is 1.0"),
        ([0, None], "number 1 is None"),
        ("ab", "number 0 is 'a'"),
        (3, "must be sequences of numbers, not 3"),
        (np.array(3), r"must be sequences of numbers, not array\(3\)"),
        (np.array([2**31]), "the array spans 2147483648 to 2147483648"),
        (np.array([2**63], np.uint64), "the array spans 9223372036854775808"),
        (np.array([1.0]), "an array of float64"),
        (np.array(["a"]), "an array of <U1"),
        (np.array([1], object), "an array of object"),
        (np.zeros((2, 3), np.int32), r"one dimension, not the shape \(2, 3\)"),
        (np.zeros((2, 3), np.int64), r"one dimension, not the shape \(2, 3\)"),
    ],
    "doubles": [
        ([0.5, "1"], "number 1 is '1'"),
        ([None], "number 0 is None"),
        ([1j], "number 0 is 1j"),
        ([1, 10**400], "of 64 bits; number 1 is 1000"),
        (0.5, r"must be sequences of numbers, not \(\) and 0.5"),
        (np.array([1j]), "an array of complex128"),
        (np.array([1.0], object), "an array of object"),
        (np.zeros((2, 3)), r"one dimension, not the shape \(2, 3\)"),
    ],
}


@pytest.mark.parametrize(
    ("run", "numbers", "error"), [(run, *wrong) for run, rows in WRONG.items() for wrong in rows]
)
def test_wrong_numbers_are_a_local_error(run: str, numbers: Any, error: str) -> None:
    with pytest.raises(LocalProtocolError, match=f"{run} .*{error}"):
        Action(**{run: numbers})


@pytest.mark.parametrize("chars", ["abc", 3, [97], bytearray(b"abc"), memoryview(b"abc"), None])
def test_chars_that_are_not_bytes_are_a_local_error(chars: Any) -> None:
    with pytest.raises(LocalProtocolError, match=r"^chars must be bytes, not "):
        Action(chars=chars)


def test_repr_shows_the_beginning() -> None:
    assert repr(Action()) == "Action()"
    assert repr(Observation([1], [0.5], b"ab")) == "Observation(ints=[1], doubles=[0.5], chars=b'ab')"
    shown = repr(Observation(range(100_000), np.zeros(100_000), bytes(100_000)))
    assert shown.startswith("Observation(ints=[0, 1, 2, 3, 4, 5, 6, 7, ...], doubles=[0.0, ")
    assert len(shown) < 300


# Hostile bodies


@given(
    st.binary(max_size=80) | st.builds(struct.pack, st.just("<4I4x"), *[st.integers(0, 3)] * 3, st.just(0))
)
def test_any_body_is_read_or_refused(body: bytes) -> None:
    try:
        value = Observation.from_body(body)
    except RemoteProtocolError:
        return
    ints, doubles, chars = value.counts
    assert len(body) == PREFIX_SIZE + 4 * ints + 8 * doubles + chars
    assert Observation(value.ints, value.doubles, value.chars) == value


@pytest.mark.parametrize(
    ("body", "error"),
    [
        (b"", "starts with 16 bytes of counts; 0 are"),
        (bytes(15), "starts with 16 bytes of counts; 15 are"),
        (struct.pack("<4I", 0, 0, 0, 7), "23 bytes; its body has 16"),
        (struct.pack("<4I", 0, 0, 0, 2 << 16) + b"x", "18 bytes; its body has 17"),
        (struct.pack("<4I", 1, 0, 0, 0), "20 bytes; its body has 16"),
        (struct.pack("<4I", 0, 0, 0, 0) + b"x", "16 bytes; its body has 17"),
    ],
)
def test_error_of_a_wrong_body_says_what_came(body: bytes, error: str) -> None:
    with pytest.raises(RemoteProtocolError, match=error):
        Observation.from_body(body)


@pytest.mark.parametrize(
    "counts", [(2**32 - 1, 0, 0), (0, 2**32 - 1, 0), (0, 0, 2**32 - 1), (2**32 - 1,) * 3]
)
def test_huge_counts_take_no_memory(counts: Sequence[int]) -> None:
    body = struct.pack("<4I", *counts, 0) + bytes(100)
    with taking_less_than(100_000), pytest.raises(RemoteProtocolError):
        Observation.from_body(body)
