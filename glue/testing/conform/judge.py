"""Judge a client: one rule after the other, each by its scene."""

from __future__ import annotations

from collections.abc import Callable, Container
from dataclasses import dataclass, replace
from enum import StrEnum

from glue.protocol.messages import Role
from glue.testing.conform.hub.clients import Start
from glue.testing.conform.hub.desk import Desk
from glue.testing.conform.hub.experiment import ExperimentDesk
from glue.testing.conform.hub.player import PlayerDesk
from glue.testing.conform.hub.rules import Broken, NotJudged, Rule, Tier
from glue.testing.conform.hub.wire import Listener
from glue.testing.conform.scenes import FIRST, all_rules

__all__ = ["Outcome", "Verdict", "judge", "rules_of"]


class Outcome(StrEnum):
    """Whether a rule was kept."""

    PASSED = "passed"
    FAILED = "failed"
    NOT_JUDGED = "not judged"


@dataclass(frozen=True)
class Verdict:
    """The verdict on one rule over one transport.

    Attributes:
        rule: the rule.
        transport: `tcp` or `ipc`.
        outcome: whether it was kept.
        expected: what should have come, if it failed; else why it was not judged.
        received: what was received instead.
        frames: the bytes of that, in hex.
    """

    rule: Rule
    transport: str
    outcome: Outcome
    expected: str = ""
    received: str = ""
    frames: tuple[str, ...] = ()

    @property
    def passed(self) -> bool:
        """Whether the client may count it: what it does not offer need not be judged."""
        return self.outcome is Outcome.PASSED


def rules_of(role: Role, tier: Tier = Tier.COMPLETE) -> list[Rule]:
    """Return the rules for a role, those of `tier` and of the tiers before it, as they are judged."""
    tiers = list(Tier)[: list(Tier).index(tier) + 1]
    return [rule for rule in all_rules(role) if rule.tier in tiers]


def judge(
    role: Role,
    start: Start,
    *,
    transport: str = "tcp",
    tier: Tier = Tier.COMPLETE,
    wait: float = 5.0,
    only: Container[str] | None = None,
    report: Callable[[Verdict], None] = lambda verdict: None,
) -> list[Verdict]:
    """Judge the clients that `start` starts by the rules of their role.

    Args:
        role: the client's.
        start: starts one; most rules are judged with the same.
        transport: `tcp` or `ipc`.
        tier: the highest tier to judge.
        wait: seconds in which whatever is to come must come.
        only: names of the rules to judge; None judges all.
        report: takes each verdict as soon as there is one.

    Raises:
        ConfigError: the client cannot be started.
    """
    listener = Listener(transport)
    desk: Desk = (ExperimentDesk if role is Role.EXPERIMENT else PlayerDesk)(role, start, listener, wait)
    verdicts: list[Verdict] = []
    try:
        for rule in rules_of(role, tier):
            if only is not None and rule.name not in only:
                continue
            broken = {v.rule.name for v in verdicts if v.outcome is Outcome.FAILED}
            verdict = _judged(rule, desk, transport, broken)
            report(verdict)
            verdicts.append(verdict)
    finally:
        desk.drop()
        listener.remove()
    return verdicts


def _judged(rule: Rule, desk: Desk, transport: str, others: set[str]) -> Verdict:
    verdict = Verdict(rule, transport, Outcome.PASSED)
    try:
        if rule not in FIRST:
            desk.ready()
        rule.scene(desk)
    except NotJudged as why:
        return replace(verdict, outcome=Outcome.NOT_JUDGED, expected=str(why))
    except Broken as broken:
        desk.abandon()
        if lacking := sorted(others.intersection(rule.needs)):
            reason = f"it rests on {', '.join(lacking)}, which the client breaks"
            return replace(verdict, outcome=Outcome.NOT_JUDGED, expected=reason)
        return replace(
            verdict,
            outcome=Outcome.FAILED,
            expected=broken.expected,
            received=broken.received,
            frames=tuple(bytes(frame).hex(" ") for frame in broken.frames),
        )
    return verdict
