"""Contract checks for hubs: one short scene for each rule of docs/protocol.md."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Final

from glue.client.libzmq import Context
from glue.core.config import check_url
from glue.testing import play, trouble
from glue.testing.rules import HubRule
from glue.testing.scripted import Scene

__all__ = ["check_hub"]


def check_hub(url: str, *, wait: float = 10.0) -> None:
    """Check that the hub at `url`, ours or one that you wrote, keeps the rules of `HubRule`.

    Each rule is checked in a session of its own with a name that nobody else uses, so the hub may be at
    work. It takes about as long as the hub's timeout. What cannot be seen without ending or filling the
    hub is not checked: its farewell, its limits.

    Args:
        url: address of the hub, which must be there.
        wait: seconds in which whatever is to come must come.

    Raises:
        ContractBroken: the message names the rule that is broken, and what was received instead.
        ConfigError: `url` is malformed.
    """
    check_url(url)
    with Context() as context:
        for rule, scene_of in _SCENES.items():
            scene = Scene(rule, context, url, wait)
            try:
                scene_of(scene)
            finally:
                scene.close()


_SCENES: Final[Mapping[HubRule, Callable[[Scene], None]]] = {
    HubRule.GREETING: play.greeting,
    HubRule.HEARTBEAT: play.heartbeat,
    HubRule.CALLS: play.calls,
    HubRule.NUMBERS: play.numbers,
    HubRule.COUNTERS: play.counters,
    HubRule.CUTOFF: play.cutoff,
    HubRule.OUTCOME: play.outcome,
    HubRule.LAST_ACTION: play.last_action,
    HubRule.MESSAGES: play.messages,
    HubRule.VERSION: play.version,
    HubRule.ROLE_TAKEN: play.role_taken,
    HubRule.UNKNOWN_PEER: trouble.unknown_peer,
    HubRule.SEED: play.seed,
    HubRule.UNSUPPORTED: play.unsupported,
    HubRule.SESSIONS: play.sessions,
    HubRule.BUSY: trouble.busy,
    HubRule.REPEATED: trouble.repeated,
    HubRule.NOT_ASKED: trouble.not_asked,
    HubRule.UNKNOWN_KIND: trouble.unknown_kind,
    HubRule.EXCEPTION: trouble.exception,
    HubRule.MALFORMED: trouble.malformed,
    HubRule.RESUMED: trouble.resumed,
    HubRule.WELCOME_LOST: trouble.welcome_lost,
    HubRule.GOODBYE: play.goodbye,
    HubRule.LOST: trouble.lost,
    HubRule.SILENT: trouble.silent,
    HubRule.REPLACED: trouble.replaced,
}
