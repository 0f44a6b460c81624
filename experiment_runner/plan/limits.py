"""The numbers of a plan, with the range of each, and its players; of modules that have to start quickly."""

from __future__ import annotations

from typing import Final

from glue.wire.messages import Role

COUNTS: Final = {
    "episodes": range(2**63),
    "steps": range(2**63),
    "max_steps": range(2**32),
    "trials": range(1, 1_000_001),
    "seed": range(2**63),
}
BUDGETS: Final = ("episodes", "steps")
"""The lengths of a trial, of which a plan has one; the other is 0."""
PLAYERS: Final = {"agent": Role.AGENT, "env": Role.ENVIRONMENT}
"""The players, by their names in options and plans."""
