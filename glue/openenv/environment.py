"""An OpenEnv server as an environment: `glue-env openenv:http://127.0.0.1:8000`.

The schemas of actions and observations, which the server publishes at /schema, become the task spec. Each
environment has a session of the server over its own connection. OpenEnv has no truncation: an episode
ends with `done`. A reward that is not stated is 0.

JSON schemas of OpenEnv as spaces of Gymnasium, and values of JSON as values of these spaces.

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
import sys
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Annotated, Any, Final, NamedTuple, TypeGuard
from urllib.parse import urlsplit

import numpy as np
from gymnasium import spaces

from glue.errors import ConfigError, SimulatorError, described
from glue.gym.spaces import INT32, Codec, SpaceLike, task_spec
from glue.options import Option
from glue.roles import Environment
from glue.system.web import MOST_BYTES, NoAnswer, ask, is_address
from glue.types import Action, Observation, Step

if TYPE_CHECKING:
    from openenv.core.sync_client import SyncEnvClient


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
        try:
            return _padded(json.dumps(value, ensure_ascii=False), max_text)
        except RecursionError:
            raise SimulatorError("a value is nested too deeply") from None

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


_MAX_MESSAGE_MB: Final = 16.0
_SEEDS: Final = 2**31
"""Servers may seed NumPy's old generator, or C's."""


class OpenEnvEnvironment(Environment):
    """The environment of the OpenEnv server at `url`, which subclasses name.

    Raises:
        ConfigError: the server does not answer, is no OpenEnv server, or its fields do not fit a task spec.
    """

    url = ""

    def __init__(
        self,
        *,
        max_text: Annotated[
            int, Option("bytes of each field without a fixed size, such as a string", low=1, high=2**16)
        ] = 4096,
        reset: Annotated[str, Option("parameters of each reset besides the seed: a JSON object")] = "",
        timeout: Annotated[
            float, Option("time to wait for an answer", low=0.1, high=86_400, unit="seconds")
        ] = 60.0,
    ) -> None:
        self._timeout = timeout
        self._reset = _parameters(reset)
        schemas = _schemas(self.url, timeout)
        try:
            self._action = read_schema(schemas.get("action"), max_text)
            self._observation = read_schema(schemas.get("observation"), max_text)
            self._actions, self._observations = Codec(self._action.space), Codec(self._observation.space)
            self._task_spec = task_spec(self._observations, self._actions)
        except ConfigError as error:
            raise ConfigError(f"{self.url}/schema: {error}") from None
        self._client: SyncEnvClient[Any, Any, Any] | None = None
        self._seed: int | None = None
        self._playing = False
        self._socket: Any = None  # over which the episode is played

    def env_seed(self, seed: int) -> None:
        """Send a seed with the next reset."""
        self._seed = seed % _SEEDS

    def env_init(self) -> str:
        """Connect to the server; return the task spec that describes its schemas."""
        from openenv.core.generic_client import GenericEnvClient

        self.env_cleanup()
        client = GenericEnvClient(
            self.url,
            connect_timeout_s=self._timeout,
            message_timeout_s=self._timeout,
            max_message_size_mb=_MAX_MESSAGE_MB,
            mode="simulation",
        ).sync()
        self._client = client
        self._ask(client.connect)
        return self._task_spec

    def env_start(self) -> Observation:
        """Reset the environment; return its observation."""
        seed, self._seed = self._seed, None
        seeded = {} if seed is None else {"seed": seed}
        result = self._ask(self._connected().reset, **self._reset, **seeded)
        self._playing, self._socket = not self._ended(result), self._open_socket()
        if not self._playing:
            raise SimulatorError(f"{self.url} ended the episode with its first observation")
        return self._observed(result)

    def env_step(self, action: Action) -> Step:
        """Carry out an action.

        Raises:
            SimulatorError: the action is not in the space, no episode is being played, or the server refuses.
        """
        client = self._connected()
        if not self._playing:
            raise SimulatorError("no episode is being played: env_start begins one")
        sent = self._action.write(self._actions.unpack(action))
        result = self._ask(client.step, sent)
        self._playing = self._open_socket() is self._socket
        if not self._playing:  # OpenEnv's client has connected again, which is another session's game.
            raise SimulatorError(f"{self.url} closed the connection in the middle of an episode")
        self._playing = not self._ended(result)
        reward = 0.0 if result.reward is None else result.reward
        if not (isinstance(reward, bool | int | float) and abs(reward) <= sys.float_info.max):
            raise SimulatorError(f"{self.url}: a reward is a finite number, not {reward!r:.80}")
        return Step(float(reward), self._observed(result), not self._playing)

    def env_cleanup(self) -> None:
        """Leave the server."""
        client, self._client, self._playing = self._client, None, False
        if client is not None:
            client.close()

    def env_message(self, message: str) -> str:
        """Answer `spaces` with the spaces of observations and actions."""
        if message == "spaces":
            return f"observations {self._observation.space}, actions {self._action.space}"
        return f"refused: {message!r:.80} is not a message of an OpenEnv environment; this is: spaces"

    def _connected(self) -> SyncEnvClient[Any, Any, Any]:
        if self._client is None:
            raise SimulatorError("the environment was cleaned up: call env_init first")
        return self._client

    def _open_socket(self) -> Any:
        return getattr(self._connected().async_client, "_ws", None)

    def _ask(self, call: Any, *args: Any, **options: Any) -> Any:
        try:
            return call(*args, **options)
        except TimeoutError:
            text = f"has not answered within {self._timeout:g} seconds, the option timeout"
            raise SimulatorError(f"{self.url} {text}") from None
        except Exception as error:  # of its library, of websockets, of asyncio: whatever the server does
            raise SimulatorError(f"{self.url}: {described(error)}") from None

    def _ended(self, result: Any) -> bool:
        if not isinstance(result.done, bool):
            raise SimulatorError(f"{self.url}: done is true or false, not {result.done!r:.80}")
        return result.done

    def _observed(self, result: Any) -> Observation:
        """Return the observation of an answer.

        Raises:
            SimulatorError: it is not as the schema says.
        """
        try:
            return Observation(*self._observations.pack(self._observation.read(result.observation)))
        except SimulatorError as error:
            raise SimulatorError(f"{self.url}: the observation is not as its schema says: {error}") from None


def environment_class(url: str) -> type[OpenEnvEnvironment]:
    """Return a class whose instances play the server at `url`, as in ``http://127.0.0.1:8000``.

    Raises:
        ConfigError: `url` is not an address of a server, or OpenEnv is not installed.
    """
    if not is_address(url):
        raise ConfigError(
            f"an OpenEnv server is named by its URL, openenv:http://127.0.0.1:8000, not {url!r:.80}"
        )
    server = url.rstrip("/")
    about = f"The OpenEnv server at {server}, served to RL-Glue agents (docs/openenv.md)."
    return type(f"openenv-{urlsplit(url).netloc}", (OpenEnvEnvironment,), {"url": server, "__doc__": about})


def _parameters(text: str) -> dict[str, Any]:
    if not text:
        return {}
    try:
        found = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise ConfigError(f"the option reset is a JSON object, and cannot be read: {error}") from None
    if not isinstance(found, dict) or "seed" in found:
        raise ConfigError(f"the option reset is a JSON object without the seed, not {text:.80}")
    return found


def _schemas(url: str, timeout: float) -> dict[str, Any]:
    """Return the schemas that a server publishes.

    Raises:
        ConfigError: it does not answer, or not with schemas.
    """
    try:
        found = ask("GET", f"{url}/schema", timeout).json
    except NoAnswer as error:
        raise ConfigError(f"no OpenEnv server answers at {url}: it {error}") from None
    if not isinstance(found, dict):
        raise ConfigError(
            f"{url}/schema is not the JSON of at most {MOST_BYTES} bytes that OpenEnv describes"
        )
    return found
