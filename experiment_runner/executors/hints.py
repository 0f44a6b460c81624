"""Lines that an experiment shows while it waits for its players."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence, Set
from pathlib import Path
from typing import Final

from glue.hub.config import DEFAULT_HUB, DEFAULT_SESSION, LegacyPort
from glue.keys.allowed import HUB
from glue.keys.certificates import PUBLIC, SECRET
from glue.plugins.loading import example
from glue.wire.messages import Role

_COMMANDS: Final = {Role.AGENT: "glue-agent", Role.ENVIRONMENT: "glue-env"}


class Hints:
    """Lines that say which players are missing, and which commands start those from outside.

    Args:
        say: shows a line.
        hub: URL at which players from outside join.
        session: the session that they join.
        named: the roles whose players the experiment starts itself; each is mentioned once.
        ports: ports at which original RL-Glue programs join.
        keys: directory of the hub's keys, which players from outside need; None for none.
    """

    def __init__(
        self,
        say: Callable[[str], None],
        hub: str,
        session: str,
        named: Collection[Role],
        ports: Sequence[LegacyPort] = (),
        keys: Path | None = None,
    ) -> None:
        self._say = say
        self._named = named
        self._starting: set[Role] = set()
        self._where = "" if hub == DEFAULT_HUB else f" --hub {_from_outside(hub)}"
        self._where += "" if session == DEFAULT_SESSION else f" --session {session}"
        if keys is not None:
            self._where += f" --key THEIRS{SECRET} --hub-key {keys / HUB}{PUBLIC}"
        legacy = " or ".join(f"{port.host}:{port.port}" for port in ports if port.session == session)
        self._legacy = f"; or an original one on {legacy}" if legacy else ""

    def show(self, missing: Set[Role]) -> None:
        """Say that the players of these roles are missing."""
        for role in sorted(missing - self._starting):
            if role in self._named:
                self._starting.add(role)
                self._say(f"waiting for the {role} to start")
            else:
                command = f"{_COMMANDS[role]} {example(role)}{self._where}"
                self._say(f"waiting for an {role}; in another terminal: {command}{self._legacy}")


def _from_outside(endpoint: str) -> str:
    """Return the URL at which outside programs reach our hub; a wildcard becomes the placeholder HOST."""
    for everywhere in ("tcp://0.0.0.0:", "tcp://[::]:"):
        if endpoint.startswith(everywhere):
            return "tcp://HOST:" + endpoint.removeprefix(everywhere)
    return endpoint
