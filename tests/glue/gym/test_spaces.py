"""Any Gymnasium space as a task spec and back."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from glue.errors import ConfigError, GlueError, SimulatorError
from glue.taskspec import parse_task_spec
from glue.types import Action, Observation

spaces: Any = pytest.importorskip("gymnasium.spaces", reason="needs Gymnasium: the extra gym")
from glue.gym.spaces import Codec, read_spaces, task_spec  # noqa: E402

pytestmark = pytest.mark.filterwarnings("ignore")

SHAPES = st.lists(st.integers(0, 3), max_size=3).map(tuple)
INTEGERS = st.sampled_from([np.int8, np.int16, np.int32, np.int64, np.uint16])
FLOATS = st.sampled_from([np.float16, np.float32, np.float64])


@st.composite
def boxes(draw: Any) -> Any:
    shape = draw(SHAPES)
    size = int(np.prod(shape, dtype=int))
    kind = draw(st.sampled_from(["float", "int", "uint8"]))
    if kind == "float":
        dtype = draw(FLOATS)
        numbers = st.floats(-100, 100, width=16)
        low = draw(st.lists(st.one_of(numbers, st.just(-np.inf)), min_size=size, max_size=size))
        high = draw(st.lists(st.one_of(numbers, st.just(np.inf)), min_size=size, max_size=size))
    else:
        dtype = np.uint8 if kind == "uint8" else draw(INTEGERS)
        limits = st.integers(0, 255 if kind == "uint8" else 100)
        low = draw(st.lists(limits, min_size=size, max_size=size))
        high = draw(st.lists(limits, min_size=size, max_size=size))
    ends = np.array([low, high], dtype).reshape(2, *shape)
    return spaces.Box(ends.min(0), ends.max(0), shape, dtype)


LEAVES = st.one_of(
    boxes(),
    st.builds(lambda n, start: spaces.Discrete(n, start=start), st.integers(1, 99), st.integers(-99, 99)),
    st.lists(st.integers(1, 9), min_size=1, max_size=4).map(spaces.MultiDiscrete),
    st.integers(1, 5).map(spaces.MultiBinary),
    st.just(spaces.MultiBinary((2, 3))),
)
SPACES = st.recursive(
    LEAVES,
    lambda inner: st.one_of(
        st.lists(inner, max_size=3).map(spaces.Tuple),
        st.dictionaries(st.text('ab ü"(é', min_size=1, max_size=4), inner, max_size=3).map(spaces.Dict),
    ),
    max_leaves=6,
)


@settings(max_examples=60)
@given(space=SPACES, action=LEAVES, seed=st.integers(0, 2**31 - 1))
def test_a_space_and_its_values_survive_the_way_there_and_back(space: Any, action: Any, seed: int) -> None:
    observations, actions = Codec(space), Codec(action)
    text = task_spec(observations, actions)
    spec = parse_task_spec(text)
    assert read_spaces(spec) == (space, action)
    space.seed(seed)
    value = Observation(*observations.pack(space.sample()))
    assert spec.observations.check(value) is None
    again = Codec(read_spaces(spec)[0])
    assert Observation(*again.pack(again.unpack(value))) == value


@settings(max_examples=60)
@given(
    space=LEAVES,
    ints=st.lists(st.integers(-(2**31), 2**31 - 1), max_size=4),
    doubles=st.lists(st.floats(), max_size=4),
    chars=st.binary(max_size=4),
)
def test_whatever_is_sent_becomes_a_value_of_the_space_or_an_error(
    space: Any, ints: list[int], doubles: list[float], chars: bytes
) -> None:
    try:
        value = Codec(space).unpack(Action(ints, doubles, chars))
    except SimulatorError:
        return
    assert space.contains(value)


def test_floats_are_clipped_and_nothing_else_is() -> None:
    box = Codec(spaces.Box(-1, 1, (3,), np.float32))
    assert box.unpack(Action(doubles=[-7, 0.5, np.inf])).tolist() == [-1, 0.5, 1]
    zero = Codec(spaces.Box(-1, -0.0, (1,), np.float64)).unpack(Action(doubles=[0.0]))
    assert not np.signbit(zero).any()
    with pytest.raises(SimulatorError, match="NaN"):
        box.unpack(Action(doubles=[0, np.nan, 0]))
    with pytest.raises(SimulatorError, match="is not in Discrete"):
        Codec(spaces.Discrete(3)).unpack(Action([3]))
    with pytest.raises(SimulatorError, match="1 ints, 0 doubles and 0 chars"):
        Codec(spaces.Discrete(3)).unpack(Action([1, 2]))


@pytest.mark.parametrize(
    ("space", "value", "message"),
    [
        (
            spaces.Box(0, 255, (2, 2), np.uint8),
            np.array([[0, 1], [0.5, 2]]),
            r"0\.5 at \[1, 0\] is not in Box",
        ),
        (spaces.Box(0, 255, (2,), np.uint8), np.array([7, 300]), r"300 at \[1\] is not in Box"),
        (spaces.Box(3, 9, (2,), np.uint8), np.array([2, 3], np.uint8), r"2 at \[0\]"),
        (spaces.Box(0, 9, (), np.int16), np.nan, "nan is not in"),
        (spaces.Discrete(5), 3.9, r"3\.9 is not in Discrete\(5\)"),
        (spaces.Discrete(10), 2**32 + 7, "4294967303 is not in"),
        (spaces.MultiBinary(2), [0, 2], r"2 at \[1\]"),
        (spaces.Box(0, 9, (2, 3), np.float32), np.zeros((3, 2)), r"the shape \(2, 3\) of .* not \(3, 2\)"),
        (spaces.Box(0, 9, (2,), np.float32), [[1], [2, 3]], "expected numbers"),
        (spaces.Discrete(2), "1", "expected numbers"),
        (spaces.Dict(a=spaces.Discrete(2)), {"b": 1}, "expected a dict of a"),
        (spaces.Tuple([spaces.Discrete(2)]), (1, 1), "expected a tuple of 1 parts"),
    ],
)
def test_a_value_outside_its_space_is_an_error_that_names_it(space: Any, value: Any, message: str) -> None:
    with pytest.raises(SimulatorError, match=message):
        Codec(space).pack(value)


def test_values_of_other_types_and_axes_that_lose_nothing_are_taken() -> None:
    assert Codec(spaces.Discrete(5)).pack(np.array([3.0]))[0].tolist() == [3]
    assert Codec(spaces.Box(0, 1, (1, 2), np.float32)).pack([1, 7])[1].tolist() == [1.0, 7.0]
    assert Codec(spaces.Box(0, 255, (2,), np.uint8)).pack([True, 255])[2] == b"\x01\xff"


def test_an_image_is_chars_and_a_dict_is_in_the_order_of_its_keys() -> None:
    image = Codec(spaces.Box(0, 255, (84, 84, 4), np.uint8))
    assert image.ranges.counts == (0, 0, 84 * 84 * 4)
    nested = Codec(spaces.Dict(b=spaces.Discrete(2), a=spaces.MultiDiscrete([5, 6])))
    ints, _, _ = nested.pack({"b": 1, "a": [3, 4]})
    assert ints.tolist() == [3, 4, 1]


@pytest.mark.parametrize(
    "space",
    [
        spaces.Text(3),
        spaces.Sequence(spaces.Discrete(2)),
        spaces.Box(0, 2**40, (), np.int64),
        spaces.Discrete(3, start=2**31 - 2),
        spaces.Dict({1: spaces.Discrete(2)}),
    ],
)
def test_what_a_task_spec_cannot_describe_is_refused(space: Any) -> None:
    with pytest.raises(ConfigError):
        Codec(space)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("OBSERVATIONS INTS (0 20) ACTIONS INTS (-1 1)", (spaces.Discrete(21), spaces.Discrete(3, start=-1))),
        (
            "OBSERVATIONS DOUBLES (2 0 1) ACTIONS INTS (0 1) (2 0 2)",
            (spaces.Box(0, 1, (2,), np.float64), spaces.MultiDiscrete([2, 3, 3])),
        ),
        (
            "OBSERVATIONS INTS (NEGINF 3) CHARCOUNT 4 ACTIONS DOUBLES (-1 UNSPEC)",
            (
                spaces.Dict(
                    ints=spaces.Box(-(2**31), 3, (1,), np.int32), chars=spaces.Box(0, 255, (4,), np.uint8)
                ),
                spaces.Box(-1, np.inf, (1,), np.float64),
            ),
        ),
    ],
)
def test_task_specs_without_a_layout_have_plain_spaces(text: str, expected: Any) -> None:
    spec = f"VERSION RL-Glue-3.0 PROBLEMTYPE episodic DISCOUNTFACTOR 1 {text} REWARDS (0 1) EXTRA"
    assert read_spaces(parse_task_spec(spec)) == expected


@pytest.mark.parametrize(
    "layout",
    ["", "{", "[]", '{"observation":{"Box":[[2],"object"]},"action":{}}', '{"observation":7}', "[" * 5000]
    + [f'{{"observation":{part},"action":{{"Discrete":"int64"}}}}' for part in (
        '{"Box":[[-1],"float32"]}', '{"Box":[[4000000000],"float32"]}', '{"Discrete":"float32"}',
        '{"Dict":[1]}', f'{{"Box":[[{10**30}],"int64"]}}',
        '{"MultiDiscrete":[[7],"int64"]}', '{"Dict":{}}', '{"Text":[3]}', '{"MultiBinary":[[true],"int8"]}',
        f'{{"Box":[[{10**30}],"float32"]}}', '{"Discrete":"int8"}', '{"Box":[[1],"int8"]}',
        '{"MultiDiscrete":[[1],"int8"]}',
    )],
)  # fmt: skip
def test_a_damaged_layout_is_refused(layout: str) -> None:
    spec = parse_task_spec(
        "VERSION RL-Glue-3.0 PROBLEMTYPE episodic DISCOUNTFACTOR 1 OBSERVATIONS INTS (0 300) "
        f"ACTIONS INTS (0 1) REWARDS (0 1) EXTRA LAYOUT {layout}"
    )
    if layout:
        with pytest.raises(GlueError):
            read_spaces(spec)
    else:
        with pytest.raises(ConfigError, match="cannot be read"):
            read_spaces(parse_task_spec(f"{spec} LAYOUT {{"))


def test_a_layout_has_no_ints_without_bounds() -> None:
    layout = '{"observation":{"Discrete":"int64"},"action":{"Discrete":"int64"}}'
    spec = parse_task_spec(
        "VERSION RL-Glue-3.0 PROBLEMTYPE episodic DISCOUNTFACTOR 1 OBSERVATIONS INTS (NEGINF POSINF) "
        f"ACTIONS INTS (0 1) REWARDS (0 1) EXTRA LAYOUT {layout}"
    )
    with pytest.raises(ConfigError, match="cannot be read"):
        read_spaces(spec)
