"""The contract check for hubs."""

from __future__ import annotations

from glue.conform.peers.checking import judged_rules
from glue.conform.peers.rules import HubRule
from glue.testing.rules import ContractBroken


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
    for rule, broken in judged_rules(url, wait):
        if broken is not None:
            raise ContractBroken(HubRule(rule.text), broken.received) from broken
