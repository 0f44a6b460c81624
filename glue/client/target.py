"""The session that a program joins, its hub, and the key by which the hub knows the program.

Settings that are not given are taken from the environment variables GLUE_HUB, GLUE_SESSION, GLUE_KEY and
GLUE_HUB_KEY, so that the runner of a competition or a user can send a program to another hub without changing
the program. This is the only module of the library that reads settings from the environment.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

from glue.errors import ConfigError, Refused
from glue.hub.config import (
    DEFAULT_HUB,
    DEFAULT_SESSION,
    HUB_KEY_VARIABLE,
    HUB_VARIABLE,
    KEY_VARIABLE,
    SESSION_VARIABLE,
)
from glue.keys.certificates import KeyPair, encode, read_pair, read_public


@dataclass(frozen=True, slots=True)
class OwnKey:
    """A program's own keys, and the public key of the hub that it joins.

    Args:
        file: the file of its own keys, for people.
        pair: its own keys.
        hub: the hub's public key, 32 bytes.
    """

    file: Path
    pair: KeyPair
    hub: bytes


@dataclass(frozen=True, slots=True)
class Target:
    """A session at a hub.

    Args:
        hub: URL of the hub.
        session: name of the session.
        key: the key by which the hub knows the program; None if it needs none.
    """

    hub: str
    session: str
    key: OwnKey | None = None


def find_target(
    hub: str | None, session: str | None, key: str | Path | None, hub_key: str | Path | None
) -> Target:
    """Return the session to join, with its hub and the keys.

    Args:
        hub: URL of the hub. If not given, it is taken from the environment, as are missing keys; if it is not
            there either, it is the default.
        session: name of the session; if not given, that of the environment, or else the default.
        key: file with the program's own pair.
        hub_key: the hub's public key, or a file that holds it.

    Raises:
        ConfigError: one of the keys is missing or cannot be read, or other users can read the secret key.
    """
    variables = os.environ
    if hub is None:
        hub = variables.get(HUB_VARIABLE) or DEFAULT_HUB
        key = key or variables.get(KEY_VARIABLE)
        hub_key = hub_key or variables.get(HUB_KEY_VARIABLE)
    return Target(hub, session or variables.get(SESSION_VARIABLE) or DEFAULT_SESSION, _own_key(key, hub_key))


def _own_key(key: str | Path | None, hub_key: str | Path | None) -> OwnKey | None:
    if not key and not hub_key:
        return None
    if not key:
        raise ConfigError(
            "hub_key needs key, the file of your own secret key: make one with glue-keys new NAME",
            settings=("key",),
        )
    if not hub_key:
        raise ConfigError(
            "key needs hub_key, the public key of the hub: ask the operator of the hub for it",
            settings=("hub_key",),
        )
    file = Path(key)
    return OwnKey(file, read_pair(file), read_public(hub_key))


def needs_key(hub: str) -> Refused:
    """Return the error of a program without a key whose hub requires one."""
    return Refused(
        f"the hub at {hub} admits only the owners of keys that it knows: make a key with glue-keys new NAME, "
        "ask the operator of the hub to allow it, and give your secret key and the public key of the hub",
        settings=("key", "hub_key"),
    )


def needs_no_key(hub: str) -> Refused:
    """Return the error of a program with a key whose hub does not encrypt."""
    return Refused(
        f"the hub at {hub} does not encrypt and knows no keys: leave out your key and the public key of the "
        "hub if you trust the network, or ask the operator of the hub to require keys",
        settings=("key", "hub_key"),
    )


def unknown_key(key: OwnKey, hub: str) -> Refused:
    """Return the error of a program whose key the hub does not know."""
    return Refused(
        f"the hub at {hub} does not know your key, {encode(key.pair.public)} in {key.file}: "
        "ask the operator of the hub to allow this key for your role and session, or give another",
        settings=("key",),
    )


def wrong_hub_key(key: OwnKey, hub: str) -> Refused:
    """Return the error of a program that expects a different public key of the hub."""
    return Refused(
        f"the public key of the hub at {hub} is not {encode(key.hub)}: "
        "ask the operator of the hub for the right one",
        settings=("hub_key",),
    )
