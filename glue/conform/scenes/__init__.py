"""Tests of a client, one for each rule, and their order."""

from __future__ import annotations

from glue.conform.hub.rules import Rule
from glue.conform.scenes import answering, asking, batches, breaks, greetings, playing, repeating, traffic
from glue.wire.messages import Role

__all__ = ["FIRST", "all_rules"]

FIRST = greetings.FIRST
"""Rules about a client's start, whose scenes start clients themselves."""


def all_rules(role: Role) -> list[Rule]:
    """Return the rules for a role in the order in which they are judged."""
    own = (asking, repeating) if role is Role.EXPERIMENT else (playing, answering, batches)
    common = [FIRST, *(module.RULES for module in (*own, traffic, breaks)), greetings.LAST]
    return [rule for rules in common for rule in rules if role in rule.roles]
