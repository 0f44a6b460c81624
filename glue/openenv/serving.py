"""An environment for OpenEnv's clients: `glue-env mario --openenv 127.0.0.1:8000`.

The routes and messages are OpenEnv's own, by its server; each connection plays its own environment.
What a task spec describes becomes typed fields: a value of the space of `glue.gym.spaces` as JSON. Chars are
a string, a character for each byte (Latin-1). A space that is not a Dict is one field, `action` or
`observation`.
"""

from __future__ import annotations

import asyncio
import json
from collections.abc import Awaitable, Callable, MutableMapping
from contextlib import suppress
from typing import Annotated, Any, Final
from urllib.parse import urlsplit

import numpy as np
import uvicorn
from gymnasium import spaces
from openenv.core.env_server.http_server import create_fastapi_app
from openenv.core.env_server.interfaces import Environment as OpenEnvironment
from openenv.core.env_server.types import Action, EnvironmentMetadata, Observation, State
from pydantic import BaseModel, Field, create_model

from glue.console import say
from glue.errors import ConfigError, SimulatorError
from glue.gym.client import GlueEnv, wrap
from glue.gym.spaces import SpaceLike
from glue.hub.config import is_local
from glue.roles import Environment

MAX_SESSIONS: Final = 64
IDLE_SECONDS: Final = 300.0
"""Time after which a connection that is in no episode is closed."""

_MAX_MESSAGE: Final = 2**20
_Message = MutableMapping[str, Any]
_Receive = Callable[[], Awaitable[_Message]]
_Send = Callable[[_Message], Awaitable[None]]


def serve(make: Callable[[], Environment], name: str, address: str, *, insecure: bool = False) -> None:
    """Serve environments to OpenEnv's clients until the process is told to end.

    Args:
        make: makes the environment of a connection.
        name: of the environment.
        address: HOST:PORT.
        insecure: whether other machines may reach the address: OpenEnv knows no keys.

    Raises:
        ConfigError: the address is not of that form, or reachable by others without `insecure`.
        SystemExit: it cannot be bound, which is printed.
    """
    host, _, port = address.rpartition(":")
    if not host or not port.isdecimal() or int(port) > 65535:
        raise ConfigError(f"an address for OpenEnv is HOST:PORT, as in 127.0.0.1:8000, not {address!r:.80}")
    if not insecure and not is_local(f"tcp://{address}"):
        raise ConfigError(
            f"{address} can be reached from other machines, and OpenEnv has no keys: bind 127.0.0.1:{port}, "
            "or set insecure if the network is your own",
            settings=("insecure",),
        )
    app = application(make, name, any_host=insecure)
    config = uvicorn.Config(
        app,
        host.strip("[]"),
        int(port),
        log_level="warning",
        ws_max_size=_MAX_MESSAGE,
        limit_concurrency=4 * MAX_SESSIONS,
        timeout_graceful_shutdown=1,
    )
    with config.bind_socket() as listening:
        listening.listen()  # Who reads the line may connect at once.
        say(f"serving {name} to OpenEnv's clients at http://{host}:{listening.getsockname()[1]}")
        uvicorn.Server(config).run([listening])


def application(
    make: Callable[[], Environment], name: str, *, any_host: bool = False, idle: float = IDLE_SECONDS
) -> Any:
    """Return the ASGI application of `serve`.

    Args:
        make: see `serve`.
        name: see `serve`.
        any_host: whether requests may name any host; otherwise only loopback, so that a page of another
            site in a browser cannot play.
        idle: seconds after which a connection that is in no episode is closed.

    Raises:
        ConfigError: the task spec does not state the actions, or has a name that OpenEnv does not allow.
    """
    app = create_fastapi_app(*_models(make, name), MAX_SESSIONS, env_name=name, mode="simulation")
    # Sessions over MCP have no connection whose end would end them, and environments of ours have no tools.
    # A step without a connection would be one of an episode that nobody has begun.
    left_out = ("/mcp", "/step")
    app.router.routes[:] = [route for route in app.routes if getattr(route, "path", None) not in left_out]
    return _Guard(app, any_host, idle)


def _models(make: Callable[[], Environment], name: str) -> tuple[Any, Any, Any]:
    """Return the class that plays an environment, and the types of its actions and observations."""
    first = wrap(make())
    spec, actions, observations = first.task_spec, first.action_space, first.observation_space
    first.close()
    action_type = _model(f"{name}Action", Action, actions, "action")
    observation_type = _model(f"{name}Observation", Observation, observations, "observation")

    def observed(
        value: Any, reward: float | None, terminated: bool, truncated: bool, info: dict[str, Any]
    ) -> Any:
        shown = _to_json(observations, value)
        fields = shown if isinstance(observations, spaces.Dict) else {"observation": shown}
        metadata: dict[str, Any] = {"truncated": True} if truncated else {}
        if "action_mask" in info:
            metadata["action_mask"] = _mask_to_json(info["action_mask"])
        return observation_type(**fields, reward=reward, done=terminated or truncated, metadata=metadata)

    class Served(OpenEnvironment):  # type: ignore[misc]
        SUPPORTS_CONCURRENT_SESSIONS = True

        def __init__(self) -> None:
            super().__init__()
            self._env: GlueEnv = wrap(make())
            self._state = State()

        def reset(self, seed: int | None = None, episode_id: str | None = None) -> Any:
            if seed is not None and type(seed) is not int:
                raise SimulatorError(f"a seed is a whole number, not {seed!r:.80}")
            observation, info = self._env.reset(seed=None if seed is None else seed % 2**63)
            self._state = State(episode_id=episode_id, step_count=0, task_spec=spec)
            return observed(observation, None, False, False, info)

        def step(self, action: Any, timeout_s: float | None = None) -> Any:
            value = action.model_dump(exclude={"metadata"})
            given = value if isinstance(actions, spaces.Dict) else value["action"]
            step = self._env.step(_from_json(actions, given))
            self._state.step_count += 1
            return observed(*step)

        def get_metadata(self) -> EnvironmentMetadata:
            return EnvironmentMetadata(name=name, description=f"The RL-Glue environment {name}")

        @property
        def state(self) -> State:
            return self._state

        def close(self) -> None:
            self._env.close()

    return Served, action_type, observation_type


def _model(name: str, base: Any, space: SpaceLike, single: str) -> Any:
    parts = space.spaces if isinstance(space, spaces.Dict) else {single: space}
    fields: dict[str, Any] = {key: (_type(part, f"{name}{key.title()}"), ...) for key, part in parts.items()}
    known: list[str] = []
    with suppress(TypeError, ValueError):  # of Pydantic, about some names
        made = create_model("".join(filter(str.isalnum, name)), __base__=base, **fields)
        known = [*made.model_fields]
    if known != [*base.model_fields, *fields]:
        raise ConfigError(
            f"OpenEnv cannot send a Dict of {', '.join(fields)}: a name may not begin with _, or be one of "
            f"its own such as {', '.join(base.model_fields) or 'model_config'}"
        )
    return made


def _type(space: SpaceLike, name: str) -> Any:
    """Return the type of the values of a space, whose JSON schema states their bounds."""
    if isinstance(space, spaces.Dict):
        return _model(name, BaseModel, space, "")
    if isinstance(space, spaces.Tuple):
        return tuple[tuple(_type(part, f"{name}{i}") for i, part in enumerate(space.spaces))]  # type: ignore[misc]
    if isinstance(space, spaces.Discrete):
        return _whole(space.start, space.start + space.n - 1)
    if isinstance(space, spaces.MultiDiscrete) and len(space.shape) == 1:
        ends = zip(space.start.tolist(), space.nvec.tolist(), strict=True)
        return tuple[tuple(_whole(start, start + n - 1) for start, n in ends)]  # type: ignore[misc]
    if _is_chars(space):
        return str
    if isinstance(space, spaces.Sequence):
        return list[_type(space.feature_space, name)]  # type: ignore[misc]
    kind: Any = float if np.dtype(space.dtype).kind == "f" else int
    for length in reversed(space.shape):
        kind = Annotated[list[kind], Field(min_length=length, max_length=length)]
    return kind


def _whole(low: Any, high: Any) -> Any:
    return Annotated[int, Field(ge=int(low), le=int(high))]


def _is_chars(space: SpaceLike) -> bool:
    kind = space.feature_space if isinstance(space, spaces.Sequence) else space
    one_row = isinstance(space, spaces.Sequence) or len(kind.shape) == 1
    return isinstance(kind, spaces.Box) and kind.dtype == np.uint8 and one_row


def _to_json(space: SpaceLike, value: Any) -> Any:
    if isinstance(space, spaces.Dict):
        return {key: _to_json(part, value[key]) for key, part in space.spaces.items()}
    if isinstance(space, spaces.Tuple):
        return [_to_json(part, one) for part, one in zip(space.spaces, value, strict=True)]
    return bytes(value).decode("latin-1") if _is_chars(space) else np.asarray(value).tolist()


def _mask_to_json(mask: Any) -> Any:
    if isinstance(mask, dict):
        return {key: _mask_to_json(part) for key, part in mask.items()}
    if isinstance(mask, tuple):
        return [_mask_to_json(part) for part in mask]
    return None if mask is None else mask.tolist()


def _from_json(space: SpaceLike, value: Any) -> Any:
    if isinstance(space, spaces.Dict):
        return {key: _from_json(part, value[key]) for key, part in space.spaces.items()}
    if isinstance(space, spaces.Tuple):
        return tuple(_from_json(part, one) for part, one in zip(space.spaces, value, strict=True))
    if _is_chars(space):
        return np.frombuffer(value.encode("latin-1", "replace"), np.uint8)
    found = np.array(value, space.dtype)
    return found[()] if isinstance(space, spaces.Discrete) else found


class _Guard:
    """Refuses requests of other sites and large ones, and closes connections long in no episode.

    The server closes a connection whose client no longer answers pings. A client that thinks answers them,
    and is not hurried.
    """

    def __init__(self, app: Any, any_host: bool, idle: float) -> None:
        self._app = app
        self._any_host = any_host
        self._idle = idle

    async def __call__(self, scope: Any, receive: _Receive, send: _Send) -> None:
        if scope["type"] == "lifespan" or self._admits(scope):
            if scope["type"] == "websocket":
                receive, send = _idle_bounded(receive, send, self._idle)
            elif scope["type"] == "http":
                receive = _size_bounded(receive)
            await self._app(scope, receive, send)
        elif scope["type"] == "websocket":
            await receive()
            await send({"type": "websocket.close", "code": 1008, "reason": "a page of another site"})
        else:
            await send({"type": "http.response.start", "status": 403, "headers": []})
            await send({"type": "http.response.body", "body": b"for clients of this machine\n"})

    def _admits(self, scope: Any) -> bool:
        headers = dict(scope["headers"])
        host = headers.get(b"host", b"").decode("latin-1")
        origin = headers.get(b"origin")
        try:
            if origin is not None and urlsplit(origin.decode("latin-1")).netloc != host:
                return False
            return self._any_host or urlsplit(f"//{host}").hostname in ("127.0.0.1", "::1", "localhost")
        except ValueError:  # brackets without an address in them
            return False


def _size_bounded(receive: _Receive) -> _Receive:
    """Return a request that breaks off where it is larger than a message of a connection may be."""
    left = _MAX_MESSAGE

    async def receiving() -> _Message:
        nonlocal left
        message = await receive()
        left -= len(message.get("body", b""))
        return message if left >= 0 else {"type": "http.disconnect"}

    return receiving


def _idle_bounded(receive: _Receive, send: _Send, idle: float) -> tuple[_Receive, _Send]:
    """Return a connection that is at its end when it has waited `idle` seconds outside of an episode."""
    playing = False

    async def receiving() -> _Message:
        try:
            return await asyncio.wait_for(receive(), None if playing else idle)
        except TimeoutError:
            await send({"type": "websocket.close", "code": 1001, "reason": f"idle for {idle:g} s"})
            return {"type": "websocket.disconnect", "code": 1001}

    async def sending(message: _Message) -> None:
        nonlocal playing
        if message["type"] == "websocket.send":
            answer = json.loads(message["text"])
            if answer["type"] == "observation":
                playing = not answer["data"]["done"]
        with suppress(OSError):  # Who has left is noticed where the next message is waited for.
            await send(message)

    return receiving, sending
