"""Serve a player in its own thread, until it is stopped."""

from __future__ import annotations

from collections.abc import Callable
from types import TracebackType
from typing import Self

from glue.client.players import serve_agent, serve_environment
from glue.errors import ConfigError
from glue.roles import AgentLike, EnvironmentLike
from glue.system.threads import Event, Thread


class Served:
    """A player that a thread serves. Made by `serve`; as a context manager, it is stopped at the end.

    Attributes:
        error: the exception that ended it; None while it is served, or if it ended normally.
    """

    def __init__(self, serve: Callable[[Event], object]) -> None:
        self.error: Exception | None = None
        self._stop = Event()
        self._thread = Thread(target=self._serve, args=(serve,), daemon=True)
        self._thread.start()

    @property
    def running(self) -> bool:
        """Whether the thread still serves the player."""
        return self._thread.is_alive()

    def stop(self) -> None:
        """Leave the session, and wait for the thread to end: a few seconds at most, or one call.

        Raises:
            GlueError: the player had ended before, with this error.
        """
        self._end()
        if self.error is not None:
            raise self.error

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._end()
        if self.error is not None and error is None:
            raise self.error

    def _end(self) -> None:
        self._stop.set()
        self._thread.join()

    def _serve(self, serve: Callable[[Event], object]) -> None:
        try:
            serve(self._stop)
        except Exception as error:
            self.error = error


def serve(
    *,
    agent: AgentLike | None = None,
    environment: EnvironmentLike | None = None,
    hub: str | None = None,
    session: str | None = None,
) -> Served:
    """Serve an agent or an environment to a hub, in a thread; return its handle at once.

    Args:
        agent: the agent; None if an environment is given.
        environment: the environment; None if an agent is given.
        hub: URL of the hub, as for `serve_agent`.
        session: name of the session, as for `serve_agent`.

    Raises:
        ConfigError: not exactly one player is given.
    """
    if (agent is None) == (environment is None):
        raise ConfigError("serve takes an agent or an environment; call it once for each")
    if agent is not None:
        return Served(lambda stop: serve_agent(agent, hub, session, stop=stop))
    assert environment is not None
    return Served(lambda stop: serve_environment(environment, hub, session, stop=stop))
