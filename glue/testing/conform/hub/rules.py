"""The rules by which a client is judged: what each says, where it stands, the scene that shows it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Any, Final

from glue.errors import GlueError
from glue.protocol.messages import THREE_ROLES, Role

__all__ = ["EVERYONE", "PLAYERS", "Broken", "NotJudged", "Rule", "Rules", "Tier"]

PLAYERS: Final = (Role.AGENT, Role.ENVIRONMENT)
EVERYONE: Final = THREE_ROLES


class Tier(StrEnum):
    """How far a client can be relied on; each tier includes those before it."""

    PLAYS = "plays"
    SURVIVES = "survives"
    COMPLETE = "complete"


class Broken(GlueError):
    """A rule is broken.

    Attributes:
        expected: what should have come.
        received: what was received instead.
        frames: its bytes.
    """

    def __init__(self, expected: str, received: str, frames: Sequence[bytes] = ()) -> None:
        super().__init__(f"expected {expected}; received {received}")
        self.expected = expected
        self.received = received
        self.frames = tuple(frames)


class NotJudged(GlueError):
    """A rule cannot be judged; the text says why."""


@dataclass(frozen=True)
class Rule:
    """One rule.

    Attributes:
        name: one word, for people and programs.
        tier: the tier that it belongs to.
        section: the heading of docs/protocol.md under which it stands, as a link's anchor.
        text: what the client does if it keeps the rule.
        roles: whom it is about.
        needs: rules without which its scene cannot be understood: if one of them is broken, a scene that goes
            wrong says nothing about this rule.
        scene: shows it, or raises Broken or NotJudged.
    """

    name: str
    tier: Tier
    section: str
    text: str
    roles: tuple[Role, ...]
    scene: Callable[[Any], None]
    needs: tuple[str, ...] = ()


class Rules(list[Rule]):
    """Rules in the order in which they are judged."""

    def add(
        self,
        name: str,
        tier: Tier,
        section: str,
        text: str,
        roles: tuple[Role, ...],
        needs: tuple[str, ...] = (),
    ) -> Callable[[Callable[[Any], None]], Callable[[Any], None]]:
        """Return a decorator that adds the rule that a scene shows."""

        def keep(scene: Callable[[Any], None]) -> Callable[[Any], None]:
            self.append(Rule(name, tier, section, text, roles, scene, needs))
            return scene

        return keep
