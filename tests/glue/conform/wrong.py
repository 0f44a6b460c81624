"""Clients with one mistake each: changes of `right`, listed in wrong.toml."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from tests.changes import Row, changed, read_table

RIGHT: Final = Path(__file__).with_name("right.py")
TABLE: Final = read_table(Path(__file__).with_suffix(".toml"))

FAULTS: Final[dict[str, dict[str, str]]] = {
    role: {name: row["breaks"][role] for name, row in TABLE.items() if role in row.get("breaks", {})}
    for role in ("agent", "environment", "experiment")
}
"""Faults of each role, each with the one rule that it breaks."""

ODDITIES: Final = [name for name, row in TABLE.items() if "breaks" not in row]
"""Unusual behaviour that breaks no rule; libzmq gives attempts up, too. Only environments are many games."""


def consequences(fault: str) -> frozenset[str]:
    """Return the rules that a fault breaks besides its own, as their scenes trigger it, too."""
    return frozenset(TABLE.get(fault, {}).get("also", ()))


def run(role: str, hub: str, session: str, fault: str = "") -> int:
    """Run a client with one fault, or none; return its exit code."""
    right: Row = {}
    module = changed(RIGHT, TABLE.get(fault, right))
    if role == "experiment":
        return int(module.Experiment(hub, session).play())
    games = 2 if role == "environment" and ("batch" in fault or fault == "is many games") else 0
    return int(module.Client(role, hub, session, games).play())
