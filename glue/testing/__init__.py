"""Contract checks that anyone can run on an agent, environment or hub of their own.

    def test_my_environment_keeps_the_contract() -> None:
        check_environment(MyEnvironment)

    def test_my_agent_keeps_the_contract() -> None:
        check_agent(MyAgent, task_spec)

    def test_my_hub_keeps_the_protocol() -> None:
        check_hub("tcp://127.0.0.1:4097")

No test framework is needed: a broken rule raises `ContractBroken`, which a framework takes for a failed
assertion. A hub may be written in any language: all that is needed is its address.
"""

from glue.testing.hub import check_hub
from glue.testing.players import check_agent, check_environment
from glue.testing.rules import ContractBroken, HubRule, Rule

__all__ = ["ContractBroken", "HubRule", "Rule", "check_agent", "check_environment", "check_hub"]
