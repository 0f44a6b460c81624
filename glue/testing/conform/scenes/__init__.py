"""Scenes that show whether a client keeps a rule, and the order in which they are judged."""

from __future__ import annotations

from glue.protocol.messages import Role
from glue.testing.conform.hub.rules import Rule
from glue.testing.conform.scenes import answering, asking, breaks, greetings, playing, repeating, traffic

__all__ = ["FIRST", "all_rules"]

FIRST = greetings.FIRST
"""Rules that are about how a client begins: their scenes start one themselves."""


def all_rules(role: Role) -> list[Rule]:
    """Return the rules for a role in the order in which they are judged."""
    own = (asking, repeating) if role is Role.EXPERIMENT else (playing, answering)
    common = [FIRST, *(module.RULES for module in (*own, traffic, breaks)), greetings.LAST]
    return [rule for rules in common for rule in rules if role in rule.roles]
