"""Rules of the protocol, each with the scene that tests it, and verdicts on them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Any

from glue.errors import GlueError
from glue.wire.messages import Role


class Tier(StrEnum):
    """Degrees of reliability of a client; each tier includes those before it."""

    PLAYS = "plays"
    SURVIVES = "survives"
    COMPLETE = "complete"


class Requirement(StrEnum):
    """Requirement levels of RFC 2119."""

    MUST = "MUST"
    SHOULD = "SHOULD"
    MAY = "MAY"


class Broken(GlueError):
    """A rule is broken.

    Attributes:
        expected: the expected message or behaviour.
        received: a description of what was received instead.
        frames: the bytes received.
    """

    def __init__(self, expected: str, received: str, frames: Sequence[bytes] = ()) -> None:
        super().__init__(f"expected {expected}; received {received}")
        self.expected = expected
        self.received = received
        self.frames: tuple[bytes, ...] = tuple(frames)


class NotJudged(GlueError):
    """A rule cannot be judged, for the reason in the text."""


Check = Callable[[Any], None]
"""A test of a rule, which raises Broken or NotJudged."""


@dataclass(frozen=True)
class Rule:
    """One rule.

    Attributes:
        name: a short identifier, unique within a role.
        tier: the tier that requires it.
        section: the anchor of its heading in docs/protocol-reference.md.
        text: the behaviour that it demands.
        roles: the roles that it applies to; none if it is for hubs.
        scene: its test.
        needs: names of rules that the scene depends on; its failure is not counted if one of them failed.
        level: the requirement level. MAY: the client need not offer it, but anything it offers has to work.
        capability: the capability that it tests; a client without it is not judged.
        mirror: whether the scene can only judge the mirror of docs/clients.md.
    """

    name: str
    tier: Tier
    section: str
    text: str
    roles: tuple[Role, ...]
    scene: Check
    needs: tuple[str, ...] = ()
    level: Requirement = Requirement.MUST
    capability: str = ""
    mirror: bool = False


class Rules(list[Rule]):
    """Rules in the order in which they are judged.

    Args:
        roles: the roles that the rules apply to by default.
    """

    def __init__(self, roles: tuple[Role, ...] = ()) -> None:
        super().__init__()
        self._roles = roles

    def add(self, tier: Tier, section: str, **more: Any) -> Callable[[Check], Check]:
        """Return a decorator that adds the rule of a scene.

        The scene's docstring is the text of the rule, and its name is the rule's name unless `more`, the
        other fields of `Rule`, gives another. A capability may be offered, everything else has to be kept.
        """

        def keep(scene: Check) -> Check:
            text = " ".join((scene.__doc__ or "").split()).removesuffix(".")
            text = text if text[1].isupper() else text[0].lower() + text[1:]
            level = Requirement.MAY if "capability" in more else Requirement.MUST
            name = scene.__name__.replace("_", "-")
            fields = {"name": name, "roles": self._roles, "level": level, **more}
            self.append(Rule(tier=tier, section=section, text=text, scene=scene, **fields))
            return scene

        return keep


class Outcome(StrEnum):
    """Whether a rule was kept."""

    PASSED = "passed"
    FAILED = "failed"
    NOT_JUDGED = "not judged"


@dataclass(frozen=True)
class Verdict:
    """The verdict on one rule over one transport.

    Attributes:
        rule: the rule.
        transport: `tcp` or `ipc`.
        outcome: whether the rule is kept.
        expected: the expected message or behaviour, if it failed; the reason, if it was not judged.
        received: a description of what was received instead.
        frames: the bytes received, in hex.
        mirror: whether the client was the mirror of docs/clients.md.
    """

    rule: Rule
    transport: str
    outcome: Outcome = Outcome.PASSED
    expected: str = ""
    received: str = ""
    frames: tuple[str, ...] = ()
    mirror: bool = True

    @property
    def violation(self) -> bool:
        """Whether the rule is violated; a broken SHOULD is reported, but is no violation."""
        return self.outcome is Outcome.FAILED and self.rule.level is not Requirement.SHOULD

    def failed(self, broken: Broken) -> Verdict:
        """Return the verdict that the rule is broken."""
        frames = tuple(bytes(frame).hex(" ") for frame in broken.frames)
        return replace(
            self, outcome=Outcome.FAILED, expected=broken.expected, received=broken.received, frames=frames
        )

    def not_judged(self, why: str) -> Verdict:
        """Return the verdict that the rule cannot be judged."""
        return replace(self, outcome=Outcome.NOT_JUDGED, expected=why)
