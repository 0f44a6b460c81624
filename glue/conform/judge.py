"""Judge a client or a hub: one rule after the other, each by its scene."""

from __future__ import annotations

from collections.abc import Callable, Container, Iterable, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import partial

from glue.conform.hub.clients import Start
from glue.conform.hub.connection import Listener
from glue.conform.hub.experiment import ExperimentHarness
from glue.conform.hub.harness import QUIET, Harness
from glue.conform.hub.player import PlayerHarness
from glue.conform.hub.rules import Broken, NotJudged, Requirement, Rule, Tier
from glue.conform.peers.checking import judged_rules
from glue.conform.scenes import FIRST, all_rules
from glue.conform.scenes.faults import play_script
from glue.wire.messages import Role


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
        outcome: whether the client keeps it.
        expected: the expected message or behaviour, if it failed; the reason, if it was not judged.
        received: a description of what was received instead.
        frames: the bytes received, in hex.
        mirror: whether the client was the mirror of docs/clients.md.
    """

    rule: Rule
    transport: str
    outcome: Outcome
    expected: str = ""
    received: str = ""
    frames: tuple[str, ...] = ()
    mirror: bool = True

    @property
    def violation(self) -> bool:
        """Whether the client violates the rule; a broken SHOULD is reported, but is no violation."""
        return self.outcome is Outcome.FAILED and self.rule.level is not Requirement.SHOULD


def rules_of(role: Role, tier: Tier = Tier.COMPLETE) -> list[Rule]:
    """Return the rules for a role in `tier` and the tiers before it, in the order of judging."""
    tiers = list(Tier)[: list(Tier).index(tier) + 1]
    return [rule for rule in all_rules(role) if rule.tier in tiers]


def judge(
    role: Role,
    start: Start,
    *,
    transport: str = "tcp",
    tier: Tier = Tier.COMPLETE,
    wait: float = 5.0,
    quiet: float = QUIET,
    only: Container[str] | None = None,
    report: Callable[[Verdict], None] = lambda verdict: None,
) -> list[Verdict]:
    """Judge the clients that `start` starts by the rules of their role.

    Args:
        role: the client's role.
        start: starts a client; most rules are judged with the same one.
        transport: `tcp` or `ipc`.
        tier: the highest tier to judge.
        wait: timeout of each message, in seconds.
        quiet: seconds of silence after which no message is expected any more.
        only: names of the rules to judge; None judges all.
        report: called with each verdict as soon as there is one.

    Raises:
        ConfigError: the client cannot be started.
    """
    rules = [rule for rule in rules_of(role, tier) if only is None or rule.name in only]
    return _judge(role, start, rules, transport, (wait, quiet), report)


def judge_scripts(
    role: Role,
    start: Start,
    seeds: Iterable[int],
    *,
    transport: str = "tcp",
    wait: float = 5.0,
    quiet: float = QUIET,
    report: Callable[[Verdict], None] = lambda verdict: None,
) -> list[Verdict]:
    """Judge clients by a script of faults for each seed; arguments and errors are those of `judge`."""
    rules = [
        Rule(
            f"seed-{seed}",
            Tier.SURVIVES,
            "breaks-replacements-and-void-episodes",
            "each call is carried out once, whatever happens to connections",
            (role,),
            partial(play_script, seed=seed),
        )
        for seed in seeds
    ]
    return _judge(role, start, rules, transport, (wait, quiet), report)


def _judge(
    role: Role,
    start: Start,
    rules: Sequence[Rule],
    transport: str,
    times: tuple[float, float],
    report: Callable[[Verdict], None],
) -> list[Verdict]:
    listener = Listener(transport)
    kit: Harness = (ExperimentHarness if role is Role.EXPERIMENT else PlayerHarness)(
        role, start, listener, *times
    )
    verdicts: list[Verdict] = []
    try:
        for rule in rules:
            broken = {v.rule.name for v in verdicts if v.outcome is Outcome.FAILED}
            verdict = replace(_judged(rule, kit, transport, broken), mirror=kit.mirror)
            report(verdict)
            verdicts.append(verdict)
    finally:
        kit.drop()
        listener.remove()
    return verdicts


def judge_hub(
    url: str, *, wait: float = 5.0, report: Callable[[Verdict], None] = lambda verdict: None
) -> list[Verdict]:
    """Judge the hub at `url` by the rules for hubs.

    Args:
        url: address of the hub, which may be in use: each rule has a session of its own.
        wait: timeout of each message, in seconds.
        report: called with each verdict as soon as there is one.

    Raises:
        ConfigError: `url` is malformed.
    """
    verdicts = []
    for rule, broken in judged_rules(url, wait):
        verdict = Verdict(rule, url.partition(":")[0], Outcome.PASSED)
        verdicts.append(verdict if broken is None else _failed(verdict, broken))
        report(verdicts[-1])
    return verdicts


def _failed(verdict: Verdict, broken: Broken) -> Verdict:
    frames = tuple(bytes(frame).hex(" ") for frame in broken.frames)
    return replace(
        verdict,
        outcome=Outcome.FAILED,
        expected=broken.expected,
        received=broken.received,
        frames=frames,
    )


def _judged(rule: Rule, kit: Harness, transport: str, others: set[str]) -> Verdict:
    verdict = Verdict(rule, transport, Outcome.PASSED)
    try:
        if rule not in FIRST:
            kit.ready()
        if rule.capability and rule.capability not in kit.capabilities:
            raise NotJudged(f"the client does not offer {rule.capability}, as it may")
        if rule.mirror and not kit.mirror:
            raise NotJudged("it needs the mirror that docs/clients.md describes")
        rule.scene(kit)
    except NotJudged as why:
        return replace(verdict, outcome=Outcome.NOT_JUDGED, expected=str(why))
    except Broken as broken:
        kit.abandon()
        if lacking := sorted(others.intersection(rule.needs)):
            reason = f"it rests on {', '.join(lacking)}, which the client breaks"
            return replace(verdict, outcome=Outcome.NOT_JUDGED, expected=reason)
        return _failed(verdict, broken)
    return verdict
