"""The keys of a hub: its own secret key, and the roles and sessions permitted to the owners of other keys."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final

from glue.errors import ConfigError
from glue.wire.messages import Role

KEY_SIZE: Final = 32
"""Size of a CURVE key, public or secret, in bytes."""


@dataclass(frozen=True, slots=True)
class Permit:
    """The roles and sessions permitted to the owner of a key.

    Args:
        name: the name that the owner of the hub gives to the owner of the key.
        roles: the roles that the owner may take.
        sessions: the sessions in which the owner may take them; None for all.
    """

    name: str
    roles: frozenset[Role]
    sessions: frozenset[str] | None = None

    def admits(self, role: Role, session: str) -> bool:
        """Return whether the owner of the key may join `session` as `role`."""
        return role in self.roles and (self.sessions is None or session in self.sessions)


@dataclass(frozen=True, slots=True)
class Keys:
    """The keys of one hub.

    Args:
        secret: the hub's own secret key.
        permits: roles and sessions by public key; any other key may join nothing.

    Raises:
        ConfigError: a key does not have 32 bytes.
    """

    secret: bytes = field(repr=False)
    permits: Mapping[bytes, Permit]

    def __post_init__(self) -> None:
        for key in (self.secret, *self.permits):
            if len(key) != KEY_SIZE:
                raise ConfigError(f"a key has {KEY_SIZE} bytes, not {len(key)}")

    def __str__(self) -> str:
        number = len(self.permits)
        return f"{number} key{'s' * (number != 1)} may join"
