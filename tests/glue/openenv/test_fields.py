from __future__ import annotations

import re
import sys
from typing import Any

import numpy as np
import pytest
from gymnasium import spaces

from glue.errors import ConfigError, SimulatorError
from glue.gym.spaces import Codec
from glue.openenv.environment import read_schema
from glue.types import Observation

SCHEMA: dict[str, Any] = {
    "$defs": {"Point": {"type": "object", "properties": {"x": {"type": "number"}, "y": {"type": "number"}}}},
    "type": "object",
    "properties": {
        "board": {
            "type": "array",
            "minItems": 2,
            "maxItems": 2,
            "items": {"type": "array", "minItems": 3, "maxItems": 3, "items": {"type": "integer"}},
        },
        "done": {"type": "boolean"},
        "level": {"type": "integer", "minimum": 1, "exclusiveMaximum": 5},
        "metadata": {"type": "object"},
        "moves": {"type": "array", "items": {"type": "integer"}},
        "name": {"type": "string"},
        "over": {"type": "boolean"},
        "place": {"$ref": "#/$defs/Point"},
        "side": {"enum": ["left", "right"]},
        "speed": {"anyOf": [{"type": "number"}, {"type": "null"}]},
        "two": {"type": "array", "minItems": 2, "maxItems": 2, "items": {"type": "boolean"}},
    },
}
VALUE: dict[str, Any] = {
    "board": [[1, 2, 3], [4, 5, 6]],
    "level": 4,
    "moves": [3, 1],
    "name": "höhle",
    "over": True,
    "place": {"x": 0.5, "y": -1.0},
    "side": "right",
    "speed": None,
    "two": [True, False],
}


def test_values_have_the_space_of_their_schema_and_come_back() -> None:
    field = read_schema(SCHEMA, 16)
    text = spaces.Box(0, 255, (16,), np.uint8)
    assert field.space == spaces.Dict(
        {
            "board": spaces.Box(-(2**31), 2**31 - 1, (2, 3), np.int64),
            "level": spaces.Discrete(4, start=1),
            "moves": text,
            "name": text,
            "over": spaces.Discrete(2),
            "place": spaces.Dict({axis: spaces.Box(-np.inf, np.inf, (), np.float64) for axis in "xy"}),
            "side": spaces.Discrete(2),
            "speed": text,
            "two": spaces.Tuple([spaces.Discrete(2)] * 2),
        }
    )
    codec = Codec(field.space)
    read = codec.unpack(Observation(*codec.pack(field.read({**VALUE, "unknown": 1}))))
    assert field.space.contains(read)
    assert bytes(read["moves"]).rstrip(b"\0") == b"[3, 1]"
    assert field.write(read) == VALUE


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ({"board": [[1, 2, 3]]}, "expected the shape (2, 3)"),
        ({"board": [[1, 2, 3], [4, 5, 2**31]]}, "2147483648 at [1, 2] is not in"),
        ({"board": [[1, 2, 3], [4]]}, "expected numbers of"),
        ({"level": 2.5}, "2.5 is not in"),
        ({"level": 10**30}, "expected numbers of"),
        ({"name": 3}, "name: expected a string"),
        ({"name": "a" * 17}, "name: a text of 17 bytes does not fit the 16"),
        ({"over": 1}, "over: expected one of"),
        ({"place": {"x": 1.0}}, "place: expected an object of x, y"),
        ({"place": {"x": "1", "y": 0.0}}, "expected numbers of"),
        ({"side": "up"}, "side: expected one of"),
        ({"two": [True]}, "two: expected 2 items"),
    ],
)
def test_value_that_is_not_as_its_schema_says_is_refused(change: dict[str, Any], expected: str) -> None:
    field = read_schema(SCHEMA, 16)
    with pytest.raises(SimulatorError, match=re.escape(expected)):
        Codec(field.space).pack(field.read({**VALUE, **change}))


def test_value_too_deep_to_be_written_is_refused() -> None:
    deep: list[Any] = []
    for _ in range(sys.getrecursionlimit() * 50):
        deep = [deep]
    field = read_schema(SCHEMA, 16)
    with pytest.raises(SimulatorError, match="moves: a value is nested too deeply"):
        field.read({**VALUE, "moves": deep})


def test_text_that_is_no_json_is_refused_as_a_value() -> None:
    field = read_schema(SCHEMA, 16)
    value = field.read(VALUE)
    value["moves"] = np.frombuffer(b"[3,".ljust(16, b"\0"), np.uint8)
    with pytest.raises(SimulatorError, match="moves: expected JSON"):
        field.write(value)


def _hundred(name: str) -> dict[str, Any]:
    items = [{"$ref": f"#/$defs/{name}"}] * 100
    return {"type": "array", "minItems": 100, "maxItems": 100, "prefixItems": items}


def _nested(depth: int, kind: str = "boolean") -> dict[str, Any]:
    leaf: dict[str, Any] = {"type": kind}
    for _ in range(depth):
        leaf = {"type": "array", "minItems": 200, "maxItems": 200, "items": leaf}
    return leaf


@pytest.mark.parametrize(
    "schema",
    [
        _nested(7),
        {"type": "array", "minItems": 10**12, "maxItems": 10**12, "items": {"type": "integer"}},
        {"type": "integer", "minimum": 0, "maximum": 10**12},
        {"type": "integer", "minimum": 5, "maximum": 1},
        {"$ref": "#/$defs/Self"},
        {"$ref": "#/$defs/nowhere"},
        {"type": "array", "minItems": 2, "maxItems": 2, "prefixItems": [True]},
        {"type": ["integer", "null"]},
        {"enum": []},
        "integer",
        None,
    ],
)
def test_schema_without_a_fixed_size_of_bounded_memory_is_a_text(schema: Any) -> None:
    definitions = {"Self": {"type": "object", "properties": {"next": {"$ref": "#/$defs/Self"}}}}
    field = read_schema({"$defs": definitions, "properties": {"value": schema}}, 8)
    assert 1 <= field.size <= 2**20


@pytest.mark.parametrize(
    ("schema", "expected"),
    [
        (None, "JSON schema of an object"),
        ({"properties": {}}, "no fields"),
        ({"properties": {"reward": {"type": "number"}}}, "no fields"),
        ({"properties": {str(i): {} for i in range(5000)}}, "more than 4096 fields"),
        ({"$defs": {"A": _hundred("B"), "B": _hundred("C")}, "properties": {"a": _hundred("A")}}, "4096 f"),
        ({"properties": {str(i): _nested(2, "number") for i in range(30)}}, "more than 1048576 numbers"),
        ({"properties": {str(i): {"type": "string"} for i in range(2**9)}}, "describes 2097152 numbers"),
        ({"properties": {"n": {"type": "number", "minimum": 2, "maximum": 1}}}, "no legal value"),
    ],
)
def test_schema_that_does_not_fit_is_refused(schema: Any, expected: str) -> None:
    with pytest.raises(ConfigError, match=expected):
        read_schema(schema, 4096)
