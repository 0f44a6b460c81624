"""Judge a client: one rule after the other, each by its scene."""

from __future__ import annotations

from collections.abc import Container, Iterable, Iterator
from dataclasses import replace
from functools import partial

from glue.conform.clients import common_rules, experiment_rules, player_rules
from glue.conform.clients.connection import Listener
from glue.conform.clients.experiment_harness import ExperimentHarness
from glue.conform.clients.fault_scripts import play_script
from glue.conform.clients.harness import QUIET, Harness
from glue.conform.clients.player_harness import PlayerHarness
from glue.conform.clients.process import Start
from glue.conform.rules import Broken, NotJudged, Outcome, Rule, Tier, Verdict
from glue.wire.messages import Role


def rules_of(role: Role, tier: Tier = Tier.COMPLETE) -> list[Rule]:
    """Return the rules for a role in `tier` and the tiers before it, in the order of judging."""
    tiers = list(Tier)[: list(Tier).index(tier) + 1]
    own = experiment_rules if role is Role.EXPERIMENT else player_rules
    rules = [*common_rules.FIRST, *own.RULES, *common_rules.RULES, *common_rules.LAST]
    return [rule for rule in rules if role in rule.roles and rule.tier in tiers]


def judge(
    role: Role,
    start: Start,
    *,
    transport: str = "tcp",
    tier: Tier = Tier.COMPLETE,
    mirror: bool = False,
    wait: float = 5.0,
    quiet: float = QUIET,
    only: Container[str] | None = None,
) -> Iterator[Verdict]:
    """Judge the clients that `start` starts by the rules of their role; yield a verdict on each.

    Args:
        role: the client's role.
        start: starts a client; most rules are judged with the same one.
        transport: `tcp` or `ipc`.
        tier: the highest tier to judge.
        mirror: the client is the mirror of docs/clients.md, whatever its name.
        wait: timeout of each message, in seconds.
        quiet: seconds of silence after which no message is expected any more.
        only: names of the rules to judge; None judges all.

    Raises, while iterating:
        ConfigError: the client cannot be started.
    """
    rules = [rule for rule in rules_of(role, tier) if only is None or rule.name in only]
    return _judge(role, start, rules, transport, mirror, wait, quiet)


def judge_scripts(
    role: Role,
    start: Start,
    seeds: Iterable[int],
    *,
    transport: str = "tcp",
    mirror: bool = False,
    wait: float = 5.0,
    quiet: float = QUIET,
) -> Iterator[Verdict]:
    """Judge clients by a script of faults for each of `seeds`; the rest is as for `judge`."""
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
    return _judge(role, start, rules, transport, mirror, wait, quiet)


def _judge(
    role: Role, start: Start, rules: Iterable[Rule], transport: str, mirror: bool, wait: float, quiet: float
) -> Iterator[Verdict]:
    listener = Listener(transport)
    harness = ExperimentHarness if role is Role.EXPERIMENT else PlayerHarness
    kit: Harness = harness(role, start, listener, mirror, wait, quiet)
    broken: set[str] = set()
    try:
        for rule in rules:
            verdict = replace(_judged(rule, kit, transport, broken), mirror=kit.mirror)
            if verdict.outcome is Outcome.FAILED:
                broken.add(rule.name)
            yield verdict
    finally:
        kit.drop()
        listener.remove()


def _judged(rule: Rule, kit: Harness, transport: str, others: set[str]) -> Verdict:
    verdict = Verdict(rule, transport)
    try:
        if rule not in common_rules.FIRST:
            kit.ready()
        if rule.capability and rule.capability not in kit.capabilities:
            raise NotJudged(f"the client does not offer {rule.capability}, as it may")
        if rule.mirror and not kit.mirror:
            raise NotJudged("it needs the mirror that docs/clients.md describes")
        rule.scene(kit)
    except NotJudged as why:
        return verdict.not_judged(str(why))
    except Broken as broken:
        kit.abandon()
        if lacking := sorted(others.intersection(rule.needs)):
            return verdict.not_judged(f"it rests on {', '.join(lacking)}, which the client breaks")
        return verdict.failed(broken)
    return verdict
