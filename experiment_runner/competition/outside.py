"""Entrants whose programs are started elsewhere: on another machine, or with access to a folder.

All entrants with a key connect to one address, and play one at a time. Meanwhile the others find no hub
there, or their session is refused, so their programs have to be restarted until the competition is over.
"""

from __future__ import annotations

import threading
from pathlib import Path

from experiment_runner.competition.settings import Entrant, Gate, Limits
from experiment_runner.competition.starting import SOCKET, Launch
from experiment_runner.store.database import reported
from experiment_runner.store.layout import write_flushed
from glue.errors import ConfigError
from glue.hub.config import Bind, Keys, Permit
from glue.keys.allowed import HUB
from glue.keys.certificates import SECRET, encode, read_pair, read_public
from glue.wire.messages import Role


def gate_for(entrant: Entrant, gate: Gate | None) -> Bind:
    """Return the address at which only the owner of an entrant's key can join, as its agent.

    Raises:
        ConfigError: there is no gate, or a key cannot be read.
    """
    if gate is None or entrant.key is None:
        raise ConfigError(
            f"entrant {entrant.name} joins with a key: give the directory of the hub's own pair (made "
            f"by glue-keys new {HUB}), and an address to listen on",
            settings=("keys", "bind"),
        )
    agent, session = frozenset({Role.AGENT}), frozenset({entrant.name})
    pair = read_pair(gate.keys / f"{HUB}{SECRET}", "keys")
    permit = Permit(entrant.name, agent, session)
    return Bind(
        gate.bind, agent, session, Keys(pair.secret, {read_public(entrant.id or entrant.key, "key"): permit})
    )


class Outside:
    """Waits for entrants that are admitted by their key; see `Starter`."""

    def check(self, entrant: Entrant, limits: Limits) -> str:
        """Return the public key, from its file unless the entrant has been admitted with it."""
        if entrant.id:
            return entrant.id
        if entrant.key is None or not entrant.key.is_file():
            raise ConfigError(
                f"there is no key {entrant.key}: ask its owner for the public key that glue-keys new has made"
            )
        return encode(read_public(entrant.key, "key"))

    def start(self, entrant: Entrant, limits: Limits, launch: Launch) -> _Elsewhere:
        """Write to the log that the program is started elsewhere."""
        with reported(f"cannot write {launch.log}"):
            write_flushed(
                launch.log, f"{entrant.name} is not started here: its log is where its program is\n"
            )
        return _Elsewhere(launch.log)

    def sweep(self, run: str) -> None:
        """Do nothing: nothing was started here."""


class InFolder(Outside):
    """Waits for entrants that find the hub's socket in a folder; access to the folder admits them."""

    def check(self, entrant: Entrant, limits: Limits) -> str:
        """Check that the folder exists."""
        if entrant.folder is None or not entrant.folder.is_dir():
            raise ConfigError(
                f"there is no folder {entrant.folder}: make it, and give only the entrant's program access"
            )
        return ""

    def start(self, entrant: Entrant, limits: Limits, launch: Launch) -> _Elsewhere:
        """Let any user connect; write to the log that the program is started elsewhere."""
        (launch.folder / SOCKET).chmod(0o666)
        return super().start(entrant, limits, launch)


class _Elsewhere:
    """An entrant's program on another machine; only its connection shows whether it is alive."""

    reason: str | None = None
    lost: str | None = None
    offence: str | None = None

    def __init__(self, log: Path) -> None:
        self.log = log
        self._stopped = threading.Event()

    def wait(self, seconds: float) -> bool:
        """Wait for this many seconds, or until `stop`; return False."""
        self._stopped.wait(seconds)
        return False

    def stop(self) -> None:
        """Stop waiting."""
        self._stopped.set()
