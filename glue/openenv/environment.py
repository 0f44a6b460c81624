"""An OpenEnv server as an environment: `glue-env openenv:http://127.0.0.1:8000`.

The schemas of actions and observations, which the server publishes at /schema, become the task spec (see
`glue.openenv.fields`). Each environment has a session of the server over a connection of its own. OpenEnv has
no truncation: an episode ends with `done`. A reward that is not stated is 0.
"""

from __future__ import annotations

import json
import sys
from typing import TYPE_CHECKING, Annotated, Any, Final
from urllib.parse import urlsplit

from glue.errors import ConfigError, SimulatorError, described
from glue.gym.codec import Codec
from glue.gym.spaces import task_spec
from glue.openenv.fields import read_schema
from glue.options import Option
from glue.roles import Environment
from glue.system.web import MOST_BYTES, NoAnswer, ask, is_address
from glue.types import Action, Observation, Step

if TYPE_CHECKING:
    from openenv.core.sync_client import SyncEnvClient

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
