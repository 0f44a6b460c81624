"""Where a program joins: the hub, the session, and the key by which the hub knows it.

What is not given is taken from the environment, GLUE_HUB, GLUE_SESSION, GLUE_KEY and GLUE_HUB_KEY, so that a
program can be sent to another hub without being changed.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

from glue.core.config import (
    DEFAULT_HUB,
    DEFAULT_SESSION,
    HUB_KEY_VARIABLE,
    HUB_VARIABLE,
    KEY_VARIABLE,
    SESSION_VARIABLE,
)
from glue.errors import ConfigError
from glue.keys.certificates import KeyPair, read_pair, read_public

__all__ = ["OwnKey", "Place", "find_place", "needs_key"]


@dataclass(frozen=True, slots=True)
class OwnKey:
    """A program's own keys, and the public key of the hub that it joins.

    Args:
        file: where its own keys are, for people.
        pair: its own keys.
        hub: the hub's public key, 32 bytes.
    """

    file: Path
    pair: KeyPair
    hub: bytes


@dataclass(frozen=True, slots=True)
class Place:
    """A session at a hub.

    Args:
        hub: URL of the hub.
        session: name of the session.
        key: by which the hub knows the program; None if it need not.
    """

    hub: str
    session: str
    key: OwnKey | None = None


def find_place(
    hub: str | None, session: str | None, key: str | Path | None, hub_key: str | Path | None
) -> Place:
    """Return where to join.

    Args:
        hub: URL of the hub. If it is not given, it is that of the environment, and so are key and hub key;
            without one it is the default.
        session: name of the session; if it is not given, that of the environment, or else the default.
        key: file with the program's own pair.
        hub_key: the hub's public key, or a file that holds it.

    Raises:
        ConfigError: one of the keys is missing or cannot be read, or others can read the secret one.
    """
    variables = os.environ
    if hub is None:
        hub = variables.get(HUB_VARIABLE) or DEFAULT_HUB
        key = key or variables.get(KEY_VARIABLE)
        hub_key = hub_key or variables.get(HUB_KEY_VARIABLE)
    return Place(hub, session or variables.get(SESSION_VARIABLE) or DEFAULT_SESSION, _own_key(key, hub_key))


def _own_key(key: str | Path | None, hub_key: str | Path | None) -> OwnKey | None:
    if not key and not hub_key:
        return None
    if not key:
        raise ConfigError("--hub-key needs --key FILE, the secret key that is yours: glue-keys new NAME")
    if not hub_key:
        raise ConfigError("--key needs --hub-key KEY: ask whoever runs the hub for its public key")
    file = Path(key)
    return OwnKey(file, read_pair(file), read_public(hub_key))


def needs_key(hub: str) -> str:
    """Return the error message for a program without a key whose hub requires one."""
    return (
        f"the hub at {hub} lets in only those whose key it knows: make one with glue-keys new NAME, ask "
        f"whoever runs the hub to allow it, and give --key NAME.key_secret --hub-key KEY"
    )
