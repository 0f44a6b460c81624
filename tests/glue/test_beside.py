"""Masks and extras of observations: their bytes, their limits, and how an agent reads masks."""

from __future__ import annotations

import pickle
from enum import Enum, IntEnum, StrEnum
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from glue.errors import LocalProtocolError, RemoteProtocolError, TaskSpecError
from glue.extras import MAX_EXTRA_NAME, MAX_EXTRAS, unpack_extras
from glue.taskspec import Range, Ranges, Space, legal_values, mask_sizes, parse_task_spec
from glue.taskspec.spaces import Discrete, task_spec
from glue.types import MAX_MASK_BITS, Action, Observation, beside_sizes, body_size, has_beside
from glue.wire.beside import beside_without, readable, readable_by_agent

INT64 = st.integers(-(2**63), 2**63 - 1)
TEXT = st.text(st.characters(exclude_categories=["Cs"]), max_size=20)
NAMES = st.text(st.characters(categories=["L", "N", "P"]), min_size=1, max_size=MAX_EXTRA_NAME)
VALUES = st.one_of(
    INT64,
    st.floats(allow_nan=False),
    TEXT,
    st.binary(max_size=20),
    st.lists(INT64, max_size=9),
    st.lists(st.floats(allow_nan=False), max_size=9),
)
EXTRAS = st.dictionaries(NAMES, VALUES, max_size=8)
MASKS = st.lists(st.booleans(), min_size=1, max_size=300)
PLAIN = Observation([1, -2], [0.5], b"ab")


@given(st.none() | MASKS, EXTRAS)
def test_what_stands_beside_an_observation_is_read_back_and_changes_nothing_else(
    mask: list[bool] | None, extras: dict[str, Any]
) -> None:
    value = Observation([1, -2], [0.5], b"ab", mask=mask, extras=extras)
    assert body_size(value.body) == len(value.body)
    assert (value.ints.tolist(), value.doubles.tolist(), value.chars) == ([1, -2], [0.5], b"ab")
    read = Observation.from_body(value.body)
    if mask is None:
        assert read.mask is None
    else:
        assert read.mask is not None
        assert read.mask[: len(mask)].tolist() == mask
        assert not read.mask[len(mask) :].any()
    assert read.extras == {k: tuple(v) if isinstance(v, list) else v for k, v in extras.items()}
    assert value.without(mask=True, extras=True) == PLAIN
    assert value.without(mask=False, extras=True) == Observation([1, -2], [0.5], b"ab", mask=mask)
    assert value.without(mask=True, extras=False) == Observation([1, -2], [0.5], b"ab", extras=extras)
    assert pickle.loads(pickle.dumps(value)) == value
    assert has_beside(value.body) == (mask is not None or bool(extras))
    assert repr(value).startswith(repr(PLAIN)[:-1])


def test_a_mask_may_be_given_in_numpys_forms() -> None:
    truth = [True, False, True] * 4
    same = Observation(mask=truth)
    for given_ in (tuple(truth), np.array(truth), np.array(truth, np.int8), np.array(truth, np.int64)):
        assert Observation(mask=given_) == same
    assert Observation(mask=[np.True_, np.False_]) == Observation(mask=[True, False])  # type: ignore[list-item]


def test_an_action_has_neither() -> None:
    for body in (Observation(mask=[True]).body, Observation(extras={"a": 1}).body):
        with pytest.raises(RemoteProtocolError, match="12 to 15 of an action must be zero"):
            Action.from_body(body)
    with pytest.raises(LocalProtocolError, match="only an observation has a mask or extras"):
        Action([1], mask=[True])


@pytest.mark.parametrize("wrong", [5, [], [2], [-1], [[True]], ["a"], np.ones((2, 2), bool), [0.5], "ab"])
def test_what_is_no_mask_is_refused(wrong: Any) -> None:
    with pytest.raises(LocalProtocolError, match="a mask has a truth value for each value"):
        Observation(mask=wrong)


def test_a_mask_is_as_large_as_its_size_can_say() -> None:
    assert beside_sizes(Observation(mask=[True] * MAX_MASK_BITS).body) == (2**16 - 1, 0)
    with pytest.raises(LocalProtocolError, match=f"1 to {MAX_MASK_BITS}"):
        Observation(mask=[True] * (MAX_MASK_BITS + 1))


class Death(StrEnum):
    FALL = "fall"


class Mode(IntEnum):
    LARGE = 1


class Named(Enum):
    FALL = "fall"


def test_extras_may_be_given_in_the_forms_of_numpy_and_enums() -> None:
    forms: list[tuple[Any, object]] = [
        (np.int32(3), 3),
        (np.float32(0.5), 0.5),
        (np.arange(3), (0, 1, 2)),
        (np.ones(2), (1.0, 1.0)),
        (np.True_, 1),
        ((1,), (1,)),
        (np.str_("a"), "a"),
        (np.bytes_(b"a"), b"a"),
        (Death.FALL, "fall"),
        (Named.FALL, "fall"),
        (Mode.LARGE, 1),
        ([np.float64(0.5), 1.0], (0.5, 1.0)),
        ([Mode.LARGE, True, 0], (1, 1, 0)),
    ]
    for given_, read in forms:
        assert Observation(extras={"a": given_}).extras == {"a": read}


@pytest.mark.parametrize(
    ("extras", "words"),
    [
        ([1], "values by name"),
        ({"a": None}, "'a' must be a number"),
        ({"a": {}}, "'a' must be a number"),
        ({"a": [[1]]}, "a flat list of ints or of floats"),
        ({"a": [1, 2.0]}, "a flat list of ints or of floats"),
        ({"a": np.ones((2, 2))}, "'a' must be a number"),
        ({"a": 2**63}, "of 64 bits"),
        ({"": 1}, "1 to 64 printable characters"),
        ({"a" * 65: 1}, "1 to 64 printable characters"),
        ({"a\nb": 1}, "1 to 64 printable characters"),
        ({3: 1}, "1 to 64 printable characters"),
        ({"a": "\ud800"}, "not Unicode"),
        ({str(n): n for n in range(MAX_EXTRAS + 1)}, "at most 64 extras; 65 are given"),
        ({"a": b"x" * 65_536}, "at most 65535 bytes"),
    ],
)
def test_richer_extras_are_refused_where_they_are_made(extras: Any, words: str) -> None:
    with pytest.raises(LocalProtocolError, match=words):
        Observation(extras=extras)


@pytest.mark.parametrize(
    ("data", "why"),
    [
        (b"\xc1", "extras that are not msgpack.*FormatError"),
        (b"\x81\xa1", "extras that are not msgpack.*incomplete"),
        (b"\x91\x01", r"extras that are \[1\] instead of a map"),
        (b"\x81\xa4a\xc2\xa0b\x00", "0 as an extra, but the name .* 'a.xa0b'"),
        (b"\x81\xa1a\xc0", "None as an extra, but the extra 'a' must be a number"),
        (b"\x82\xa1a\x01\xa1a\x02", "two extras with the same name"),
    ],
)
def test_bytes_that_are_no_extras_are_explained(data: bytes, why: str) -> None:
    with pytest.raises(RemoteProtocolError, match=f"^the environment sent {why}"):
        unpack_extras(data)


@pytest.mark.parametrize("mask", [False, True])
@pytest.mark.parametrize("extras", [False, True])
def test_a_peer_is_sent_what_it_reads_and_an_agent_never_extras(mask: bool, extras: bool) -> None:
    full = Observation([7], mask=[True, False], extras={"a": 1})
    capabilities = {name for name, offered in (("mask", mask), ("extras", extras)) if offered}
    assert readable(full.body, capabilities) == full.without(mask=not mask, extras=not extras).body
    assert readable_by_agent(full.body, capabilities) == full.without(mask=not mask, extras=True).body
    missing = beside_without(full.body, capabilities)
    assert missing == ("" if mask and extras else "extras" if mask else "mask")
    assert beside_without(PLAIN.body, set()) == ""


SPEC = task_spec(
    Discrete(5), Space(ints=Ranges.of(Range(0, 3), Range(-1, 0))), extra="a word, masks LAYOUT {}"
)


def test_an_agent_reads_the_legal_values_of_each_int() -> None:
    spec = parse_task_spec(SPEC)
    assert spec.masks
    sizes = mask_sizes(spec.actions)
    assert sizes == (4, 2)
    first, second = legal_values(Observation(mask=[0, 1, 0, 1, 0, 1]), sizes)  # type: ignore[list-item]
    assert (first.tolist(), second.tolist()) == ([False, True, False, True], [False, True])
    assert [legal.all() for legal in legal_values(PLAIN, sizes)] == [True, True]
    with pytest.raises(ValueError, match="read-only"):
        first[0] = True


@pytest.mark.parametrize(
    ("mask", "words"),
    [
        ([True] * 7, "6 values fill 1 byte of mask, the spare bits zero, not 0x7f"),
        ([True] * 9, "6 values fill 1 byte"),
        ([True, True, True, True, False, False], "no value of int 1 is legal"),
    ],
)
def test_a_mask_that_does_not_fit_is_the_environments_error(mask: list[bool], words: str) -> None:
    with pytest.raises(RemoteProtocolError, match=words):
        legal_values(Observation(mask=mask), (4, 2))


def test_there_is_no_mask_for_ints_without_bounds_or_too_many_values() -> None:
    for text in ("(0 POSINF)", "(UNSPEC 3)", "(0 1000000)", "(9999999 0 1)"):
        spec = parse_task_spec(SPEC.replace("(0 3) (-1 0)", text))
        with pytest.raises(TaskSpecError, match="masks for at most"):
            mask_sizes(spec.actions)
    assert not parse_task_spec(SPEC.replace("masks", "masked")).masks
