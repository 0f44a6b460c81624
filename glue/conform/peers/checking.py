"""Judge a hub: one rule after the other, each by its scene."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import closing
from typing import Final

from glue.client.libzmq import Context
from glue.conform.hub.rules import Broken, Rule, Tier
from glue.conform.peers import failing, playing
from glue.conform.peers.rules import HubRule
from glue.conform.peers.scripted import Scene
from glue.hub.config import check_url

_SCENES: Final[tuple[tuple[HubRule, Tier, str, Callable[[Scene], None]], ...]] = (
    (HubRule.GREETING, Tier.PLAYS, "greeting", playing.greeting),
    (HubRule.HEARTBEAT, Tier.PLAYS, "greeting", playing.heartbeat),
    (HubRule.CALLS, Tier.PLAYS, "what-the-calls-mean", playing.calls),
    (HubRule.NUMBERS, Tier.PLAYS, "calls-and-how-each-happens-exactly-once", playing.numbers),
    (HubRule.COUNTERS, Tier.PLAYS, "what-the-calls-mean", playing.counters),
    (HubRule.CUTOFF, Tier.PLAYS, "what-the-calls-mean", playing.cutoff),
    (HubRule.OUTCOME, Tier.COMPLETE, "capabilities", playing.outcome),
    (HubRule.LAST_ACTION, Tier.PLAYS, "what-the-calls-mean", playing.last_action),
    (HubRule.MESSAGES, Tier.PLAYS, "what-the-calls-mean", playing.messages),
    (HubRule.VERSION, Tier.COMPLETE, "greeting", playing.version),
    (HubRule.ROLE_TAKEN, Tier.COMPLETE, "breaks-replacements-and-void-episodes", playing.role_taken),
    (HubRule.UNKNOWN_PEER, Tier.SURVIVES, "errors", failing.unknown_peer),
    (HubRule.SEED, Tier.COMPLETE, "capabilities", playing.seed),
    (HubRule.UNSUPPORTED, Tier.COMPLETE, "capabilities", playing.unsupported),
    (HubRule.SESSIONS, Tier.COMPLETE, "overview", playing.sessions),
    (HubRule.BUSY, Tier.COMPLETE, "calls-and-how-each-happens-exactly-once", failing.busy),
    (HubRule.REPEATED, Tier.SURVIVES, "calls-and-how-each-happens-exactly-once", failing.repeated),
    (HubRule.NOT_ASKED, Tier.COMPLETE, "errors", failing.not_asked),
    (HubRule.UNKNOWN_KIND, Tier.COMPLETE, "errors", failing.unknown_kind),
    (HubRule.EXCEPTION, Tier.COMPLETE, "errors", failing.exception),
    (HubRule.MALFORMED, Tier.COMPLETE, "errors", failing.malformed),
    (HubRule.RESUMED, Tier.SURVIVES, "breaks-replacements-and-void-episodes", failing.resumed),
    (HubRule.WELCOME_LOST, Tier.SURVIVES, "greeting", failing.welcome_lost),
    (HubRule.GOODBYE, Tier.PLAYS, "greeting", playing.goodbye),
    (HubRule.LOST, Tier.SURVIVES, "breaks-replacements-and-void-episodes", failing.lost),
    (HubRule.SILENT, Tier.SURVIVES, "breaks-replacements-and-void-episodes", failing.silent),
    (HubRule.REPLACED, Tier.SURVIVES, "breaks-replacements-and-void-episodes", failing.replaced),
)

RULES: Final = tuple(
    Rule(rule.name.lower().replace("_", "-"), tier, section, str(rule), (), scene)
    for rule, tier, section, scene in _SCENES
)
"""The rules for a hub in the order in which they are judged, as in `HubRule`."""


def judged_rules(url: str, wait: float) -> Iterator[tuple[Rule, Broken | None]]:
    """Judge the hub at `url`; yield each rule, and an error if it is broken.

    Args:
        url: address of the hub.
        wait: timeout of each message, in seconds.

    Raises:
        ConfigError: `url` is malformed.
    """
    check_url(url)
    with Context() as context:
        for rule in RULES:
            with closing(Scene(rule.name, context, url, wait)) as scene:
                try:
                    rule.scene(scene)
                except Broken as broken:
                    yield rule, broken
                else:
                    yield rule, None
