"""Contract checks that anyone can run on an agent, environment or hub of their own.

    def test_my_environment_keeps_the_contract() -> None:
        check_environment(MyEnvironment)

    def test_my_agent_keeps_the_contract() -> None:
        check_agent(MyAgent, task_spec)

    def test_my_hub_keeps_the_protocol() -> None:
        check_hub("tcp://127.0.0.1:4097")

No test framework is needed: a broken rule raises `ContractBroken`, which a framework reports as a
failed assertion. A hub may be written in any language: all that is needed is its address.
"""

from __future__ import annotations

from importlib import import_module

TYPE_CHECKING = False  # not imported: see glue.cli.entry
if TYPE_CHECKING:
    from typing import Any, Final

    from glue.conform.peers.rules import HubRule
    from glue.testing.hub import check_hub
    from glue.testing.players import check_agent, check_environment
    from glue.testing.rules import ContractBroken, Rule

__all__ = ["ContractBroken", "HubRule", "Rule", "check_agent", "check_environment", "check_hub"]

_HOMES: Final = {
    "check_hub": "glue.testing.hub",
    "check_agent": "glue.testing.players",
    "check_environment": "glue.testing.players",
    "ContractBroken": "glue.testing.rules",
    "HubRule": "glue.conform.peers.rules",
    "Rule": "glue.testing.rules",
}


def __getattr__(name: str) -> Any:
    """Import a check when it is first used, so that `glue-conform --help` imports none."""
    if name not in _HOMES:
        raise AttributeError(f"module 'glue.testing' has no attribute {name!r}")
    found = globals()[name] = getattr(import_module(_HOMES[name]), name)
    return found
