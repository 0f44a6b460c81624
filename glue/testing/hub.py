"""The contract check for hubs."""

from __future__ import annotations

from enum import EnumMeta, StrEnum
from typing import TYPE_CHECKING

from glue.conform.hubs.judge import judge_hub
from glue.conform.hubs.rules import RULES
from glue.conform.rules import Outcome
from glue.testing.players import ContractBroken

if TYPE_CHECKING:

    class _AnyName(EnumMeta):
        def __getattr__(cls, name: str) -> HubRule: ...

    class HubRule(StrEnum, metaclass=_AnyName):
        pass

else:
    HubRule = StrEnum("HubRule", {rule.name.replace("-", "_").upper(): rule.text for rule in RULES})

HubRule.__doc__ = "Rules for hubs, in the order in which they are judged; see docs/protocol-reference.md."


def check_hub(url: str, *, wait: float = 10.0) -> None:
    """Check that the hub at `url`, ours or your own, keeps the rules of `HubRule`.

    Each rule is checked in a session of its own with a random name, so the hub may be in use. The check
    takes about as long as the hub's timeout. The hub's farewell and limits are not checked, as that would
    take ending or filling the hub. `glue-conform hub` prints a verdict for each rule.

    Args:
        url: address of the hub, which must be running.
        wait: timeout of each message, in seconds.

    Raises:
        ContractBroken: the message names the broken rule, and what was received.
        ConfigError: `url` is malformed.
    """
    for verdict in judge_hub(url, wait=wait):
        if verdict.outcome is Outcome.FAILED:
            raise ContractBroken(HubRule(verdict.rule.text), verdict.received)
