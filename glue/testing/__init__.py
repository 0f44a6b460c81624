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
    from typing import Any

    from glue.testing.hub import HubRule, check_hub
    from glue.testing.players import ContractBroken, Rule, check_agent, check_environment

__all__ = ["ContractBroken", "HubRule", "Rule", "check_agent", "check_environment", "check_hub"]


def __getattr__(name: str) -> Any:
    """Import a check when it is first used, so that `glue-conform --help` imports none."""
    if name not in __all__:
        raise AttributeError(f"module 'glue.testing' has no attribute {name!r}")
    home = "hub" if "hub" in name.lower() else "players"
    found = globals()[name] = getattr(import_module(f"glue.testing.{home}"), name)
    return found
