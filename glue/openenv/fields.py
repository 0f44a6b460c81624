"""JSON schemas of OpenEnv as spaces of Gymnasium, and values of JSON as values of these spaces.

    boolean                                   Discrete(2)
    enum, const                               Discrete: the index of the value
    integer with both bounds                  Discrete
    integer, number                           Box of one number
    array of so many numbers                  Box
    array of so many other values             Tuple
    object                                    Dict
    anything else, such as a string           Box of uint8: UTF-8, padded with zeros

A string is its text; other values that have no fixed size are JSON.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final, NamedTuple, TypeGuard

import numpy as np
from gymnasium import spaces

from glue.errors import ConfigError, SimulatorError
from glue.gym.codec import INT32, SpaceLike

_MAX_DEPTH: Final = 8
_MAX_FIELDS: Final = 4096  # each item of a tuple is one; a task spec has no room for more
_MAX_NUMBERS: Final = 2**20
_ENVELOPE: Final = ("metadata", "done", "reward")
"""Properties of OpenEnv's base classes: beside the observation in a message, or not the environment's own."""


class Field(NamedTuple):
    """A schema's space, and the functions from a value of JSON to one of the space and back.

    Both functions raise SimulatorError if a text, a choice or an object is not as the schema says; the codec
    of the space checks numbers. `size` is the number of ints, doubles and chars.
    """

    space: SpaceLike
    read: Callable[[Any], Any]
    write: Callable[[Any], Any]
    size: int = 1


def read_schema(schema: Any, max_text: int) -> Field:
    """Return the field of a schema of actions or of observations: an object.

    Args:
        schema: as JSON.
        max_text: bytes of each text, at least one.

    Raises:
        ConfigError: it is no schema of an object, has no fields, or too many.
    """
    if not isinstance(schema, dict) or not isinstance(schema.get("properties"), dict):
        raise ConfigError(f"expected the JSON schema of an object, not {schema!r:.80}")
    own = {name: one for name, one in schema["properties"].items() if name not in _ENVELOPE}
    if not own:
        raise ConfigError("the schema has no fields: its actions or observations are not values")
    field = _Schemas(schema.get("$defs"), max_text).object(own, 0)
    if field.size > _MAX_NUMBERS:
        raise ConfigError(
            f"the schema describes {field.size} numbers and bytes; at most {_MAX_NUMBERS} are read"
        )
    return field


class _Schemas:
    def __init__(self, definitions: Any, max_text: int) -> None:
        self._definitions = definitions if isinstance(definitions, dict) else {}
        self._string, self._json = _string(max_text), _json(max_text)
        self._fields = 0
        self._numbers = 0  # of all arrays

    def object(self, properties: Mapping[str, Any], depth: int) -> Field:
        return _object({name: self._field(one, depth + 1) for name, one in properties.items()})

    def _count(self, fields: int, numbers: int = 0) -> None:
        """Count what is about to be made: a short schema may describe much."""
        self._fields += fields
        self._numbers += numbers
        if self._fields > _MAX_FIELDS:
            raise ConfigError(f"the schema has more than {_MAX_FIELDS} fields")
        if self._numbers > _MAX_NUMBERS:
            raise ConfigError(f"the schema describes more than {_MAX_NUMBERS} numbers and bytes")

    def _field(self, schema: Any, depth: int) -> Field:
        self._count(1)
        while isinstance(schema, dict) and isinstance(schema.get("$ref"), str) and depth <= _MAX_DEPTH:
            schema, depth = self._definitions.get(schema["$ref"].rpartition("/")[2]), depth + 1
        if not isinstance(schema, dict) or depth > _MAX_DEPTH:
            return self._json
        kind = schema.get("type")
        values = [schema["const"]] if "const" in schema else schema.get("enum")
        properties = schema.get("properties")
        if isinstance(values, list) and 0 < len(values) <= _MAX_NUMBERS:
            return _choice(values)
        if kind == "object" and isinstance(properties, dict) and properties:
            return self.object(properties, depth)
        if kind == "array":
            return self._array(schema, depth) or self._json
        if kind == "integer":
            return _integer(schema) or self._json
        if kind == "number":
            return _number(schema)
        if kind == "boolean":
            return _choice([False, True])
        return self._string if kind == "string" else self._json

    def _array(self, schema: Mapping[str, Any], depth: int) -> Field | None:
        """Return the field of an array with a fixed number of items; None if it is not stated or large."""
        count, parts = schema.get("minItems"), schema.get("prefixItems")
        if type(count) is not int or count != schema.get("maxItems") or not 0 < count <= _MAX_NUMBERS:
            return None
        if isinstance(parts, list) and parts:
            return _tuple([self._field(part, depth + 1) for part in parts]) if len(parts) == count else None
        before = self._fields
        item = self._field(schema.get("items"), depth + 1)
        if item.size * count > _MAX_NUMBERS:
            return None
        if isinstance(item.space, spaces.Box) and item.space.dtype != np.uint8:
            self._count(0, item.size * (count - 1))
            low, high = (np.tile(end, (count, *(1,) * end.ndim)) for end in (item.space.low, item.space.high))
            return _numbers(spaces.Box(low, high, dtype=item.space.dtype.type), item.size * count)
        fields = (self._fields - before) * (count - 1)
        if self._fields + fields > _MAX_FIELDS:
            return None
        self._count(fields)
        return _tuple([item] * count)


def _object(fields: Mapping[str, Field]) -> Field:
    def read(value: Any) -> dict[str, Any]:
        if not isinstance(value, dict) or not fields.keys() <= value.keys():
            raise SimulatorError(f"expected an object of {', '.join(fields)}, not {value!r:.80}")
        return {name: _within(name, field.read, value[name]) for name, field in fields.items()}

    def write(value: Any) -> dict[str, Any]:
        return {name: _within(name, field.write, value[name]) for name, field in fields.items()}

    space = spaces.Dict({name: field.space for name, field in fields.items()})
    return Field(space, read, write, sum(field.size for field in fields.values()))


def _tuple(fields: Sequence[Field]) -> Field:
    def read(value: Any) -> tuple[Any, ...]:
        if not isinstance(value, list) or len(value) != len(fields):
            raise SimulatorError(f"expected {len(fields)} items, not {value!r:.80}")
        return tuple(_within(i, field.read, value[i]) for i, field in enumerate(fields))

    def write(value: Any) -> list[Any]:
        return [field.write(part) for field, part in zip(fields, value, strict=True)]

    return Field(
        spaces.Tuple([field.space for field in fields]), read, write, sum(one.size for one in fields)
    )


def _within(name: str | int, convert: Callable[[Any], Any], value: Any) -> Any:
    try:
        return convert(value)
    except SimulatorError as error:
        raise SimulatorError(f"{name}: {error}") from None


def _numbers(space: SpaceLike, size: int = 1) -> Field:
    """Return the field of numbers that are the same in JSON; the codec of the space checks them."""
    return Field(space, lambda value: value, lambda value: np.asarray(value).tolist(), size)


def _choice(values: Sequence[Any]) -> Field:
    def read(value: Any) -> int:
        for index, one in enumerate(values):
            if type(one) is type(value) and one == value:
                return index
        raise SimulatorError(f"expected one of {[*values]!r:.200}, not {value!r:.80}")

    return Field(spaces.Discrete(len(values)), read, lambda index: values[int(index)])


def _integer(schema: Mapping[str, Any]) -> Field | None:
    """Return the field of a whole number; None if its bounds need more than 32 bits."""
    low, high = _bound(schema, "inimum", 1, INT32.min), _bound(schema, "aximum", -1, INT32.max)
    if not INT32.min <= low <= high <= INT32.max:
        return None
    if low > INT32.min and high < INT32.max:
        return _numbers(spaces.Discrete(int(high) - int(low) + 1, start=int(low)))
    return _numbers(spaces.Box(int(low), int(high), (), np.int64))


def _number(schema: Mapping[str, Any]) -> Field:
    low, high = _bound(schema, "inimum", 0, -np.inf), _bound(schema, "aximum", 0, np.inf)
    if not low <= high:
        raise ConfigError(f"a number of the schema has no legal value: {schema!r:.80}")
    return _numbers(spaces.Box(low, high, (), np.float64))


def _bound(schema: Mapping[str, Any], kind: str, beside: int, default: float) -> float:
    """Return the bound `m{kind}` of a schema, or that beside `exclusiveM{kind}`; `default` without either."""
    found, exclusive = schema.get(f"m{kind}"), schema.get(f"exclusiveM{kind}")
    if _is_number(found):
        return float(found)
    return float(exclusive) + beside if _is_number(exclusive) else default


def _is_number(value: Any) -> TypeGuard[float]:
    return type(value) in (int, float) and abs(value) < 2**53


def _string(max_text: int) -> Field:
    def read(value: Any) -> Any:
        if not isinstance(value, str):
            raise SimulatorError(f"expected a string, not {value!r:.80}")
        return _padded(value, max_text)

    return Field(spaces.Box(0, 255, (max_text,), np.uint8), read, _unpadded, max_text)


def _json(max_text: int) -> Field:
    def read(value: Any) -> Any:
        return _padded(json.dumps(value, ensure_ascii=False), max_text)

    def write(value: Any) -> Any:
        text = _unpadded(value)
        try:
            return json.loads(text)
        except (ValueError, RecursionError) as error:
            raise SimulatorError(f"expected JSON, not {text!r:.80} ({error})") from None

    return Field(spaces.Box(0, 255, (max_text,), np.uint8), read, write, max_text)


def _padded(text: str, size: int) -> Any:
    data = text.encode(errors="replace")
    if len(data) > size:
        raise SimulatorError(f"a text of {len(data)} bytes does not fit the {size} of the option max_text")
    return np.frombuffer(data.ljust(size, b"\0"), np.uint8)


def _unpadded(value: Any) -> str:
    return bytes(value).rstrip(b"\0").decode(errors="replace")
