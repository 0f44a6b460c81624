"""A hub's directory of keys, which determines who may join it, and in which roles and sessions:

    keys/hub.key_secret    the hub's own pair, made by `glue-keys new hub --dir keys`
    keys/hub.key           its public half, for everyone who may join
    keys/carol.key         the public key that Carol sent
    keys/allow.toml        the roles and sessions of each key

    # allow.toml
    [carol]
    role = "agent"                            # or several: ["agent", "environment"]
    session = ["a", "b"]                      # left out: every session
    key = "carol.pub"                         # left out: carol.key or carol.pub; or the 40 characters

The permissions of all keys are in this one file of the hub's owner, not in the file of a key, which comes
from the owner of the key.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from glue.console import did_you_mean
from glue.errors import ConfigError
from glue.hub.config import Keys, Permit, check_session
from glue.keys.certificates import PUBLIC, SECRET, decode, read_pair, read_public
from glue.keys.files import check_directory, read_own
from glue.wire.messages import Role

HUB: Final = "hub"
"""The name of the hub's own pair."""

LIST: Final = "allow.toml"

_MAX_LIST: Final = 2**20
_FIELDS: Final = ("role", "session", "key")


def read_keys(directory: Path) -> Keys:
    """Read the keys in the directory of a hub.

    Raises:
        ConfigError: a file is missing, damaged or open to other users, or its content is not valid.
    """
    try:
        return _read(directory)
    except OSError as error:
        raise ConfigError(f"cannot read the keys in {directory}: {error.strerror}") from None
    except (ValueError, RecursionError) as error:
        raise ConfigError(f"cannot read the keys in {directory}: {type(error).__name__}") from None


def _read(directory: Path) -> Keys:
    from glue.wire.curve import public_key  # needs an extra

    own = directory / f"{HUB}{SECRET}"
    if not own.exists():
        raise ConfigError(
            f"there is no {own}, the hub's own key: make it in {directory} with glue-keys new {HUB}",
            settings=("keys",),
        )
    pair = read_pair(own)
    check_directory(directory)
    if public_key(pair.secret) != pair.public:
        raise ConfigError(f"{own} is damaged: its two keys do not belong together")
    text = _read_list(directory / LIST)
    try:
        document = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise ConfigError(f"{directory / LIST} is not TOML: {error}") from None
    permits: dict[bytes, Permit] = {}
    for name, table in document.items():
        try:
            key, permit = _permit(directory, name, table)
        except ConfigError as error:
            raise ConfigError(f"{directory / LIST}: [{name}] {error}") from None
        if key in permits:
            raise ConfigError(
                f"{directory / LIST}: {permits[key].name} and {name} have the same key; one table can name "
                "several roles and sessions"
            )
        permits[key] = permit
    return Keys(pair.secret, permits)


def _read_list(path: Path) -> str:
    try:
        data = read_own(path, _MAX_LIST)
    except FileNotFoundError:
        raise ConfigError(
            f"there is no {path}, the list of those who may join. For a key carol{PUBLIC} in {path.parent} "
            'write:\n[carol]\nrole = "agent"\nsession = "a"',
            settings=("keys",),
        ) from None
    try:
        return data.decode()
    except UnicodeDecodeError as error:
        raise ConfigError(f"{path} is not UTF-8: {error.reason}") from None


def _permit(directory: Path, name: str, table: object) -> tuple[bytes, Permit]:
    if not isinstance(table, dict):
        raise ConfigError(f"should be a table, not {table!r:.60}")
    for field in table:
        if field not in _FIELDS:
            raise ConfigError(f"has a field {field!r}{did_you_mean(field, _FIELDS)}")
    return _key(directory, name, table), Permit(name, _roles(table), _sessions(table))


def _roles(table: Mapping[str, Any]) -> frozenset[Role]:
    words = _words(table, "role")
    if not words:
        raise ConfigError('does not say which role it may take, as in: role = "agent"')
    for word in words:
        if word not in list(Role):
            raise ConfigError(f"names the role {word!r}{did_you_mean(word, Role)}")
    return frozenset(map(Role, words))


def _sessions(table: Mapping[str, Any]) -> frozenset[str] | None:
    if "session" not in table:
        return None
    words = _words(table, "session")
    if not words:
        raise ConfigError("may join no session; leave the field out for every session")
    return frozenset(map(check_session, words))


def _words(table: Mapping[str, Any], field: str) -> list[str]:
    value = table.get(field, [])
    words = value if isinstance(value, list) else [value]
    if not all(isinstance(word, str) for word in words):
        raise ConfigError(f"{field} should be a string or a list of strings, not {value!r:.60}")
    return words


def _key(directory: Path, name: str, table: Mapping[str, Any]) -> bytes:
    given = table.get("key")
    if given is None:
        for ending in (PUBLIC, ".pub"):
            path = directory / f"{name}{ending}"
            if path.exists():
                return read_public(path)
        raise ConfigError(
            f"has no key: put the file that its owner sent there, as {directory / name}{PUBLIC}"
        )
    if not isinstance(given, str):
        raise ConfigError(f"key should be the name of a file or a key, not {given!r:.60}")
    path = directory / given
    if path.is_file():
        return read_public(path, "key")
    try:
        return decode(given)  # never a file of that name elsewhere, such as where the hub was started
    except ValueError:
        raise ConfigError(
            f"key: {given!r:.120} is neither a file in {directory} nor a key of 40 characters"
        ) from None
