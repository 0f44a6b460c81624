"""The kit finds faults: a client with one fault breaks the rules that the fault concerns, and no others."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial

import pytest

from glue.conform.clients.judge import judge, rules_of
from glue.conform.report import line
from glue.conform.rules import Outcome
from glue.wire.messages import THREE_ROLES, Role
from tests.changes import changed
from tests.glue.conform.forked import wrong
from tests.glue.conform.wrong import FAULTS, ODDITIES, RIGHT, TABLE, consequences
from tests.proof import size

COMMON = {"hello", "calls", "repeated", "numbers"}
"""Rules by which every client is judged, besides that of its fault; `make proof` judges it by all rules."""


HASTE, PATIENCE = (1.0, 0.05), (60.0, 0.25)
"""Seconds to wait for a message, and of silence.

HASTE comes first, since waiting for a wrong client is mostly in vain. On a busy machine a right answer can
come late, and a wrong one after the silence: surprising verdicts are judged again, with PATIENCE.
"""


def misjudged(role: Role, fault: str, times: tuple[float, float]) -> list[str]:
    """Judge a client; return each verdict that its fault does not explain, and each that is missing."""
    rule = FAULTS[role].get(fault)
    broken = {rule, *consequences(fault)}
    some = None if rule is None else {rule, *COMMON}
    wait, quiet = times
    verdicts = [*judge(role, wrong(role, fault), wait=wait, quiet=quiet, only=size(some, None))]
    failed = [verdict for verdict in verdicts if verdict.outcome is Outcome.FAILED]
    # Rules that depend on the broken one need not be judged; all others must be.
    unjudged = [
        verdict
        for verdict in verdicts
        if verdict.outcome is Outcome.NOT_JUDGED
        and broken.isdisjoint(verdict.rule.needs)
        and verdict.mirror
        and verdict.rule.name != "batch"  # only one of the environments is a batch
    ]
    missed = (
        [f"{rule} was kept"] if rule and broken.isdisjoint(verdict.rule.name for verdict in failed) else []
    )
    return missed + [line(verdict) for verdict in [*failed, *unjudged] if verdict.rule.name not in broken]


def judge_all(role: Role, faults: Sequence[str]) -> None:
    """Judge a client with each fault, and expect no surprise."""
    with ThreadPoolExecutor(10) as pool:  # the threads mostly wait
        hasty = dict(zip(faults, pool.map(partial(misjudged, role, times=HASTE), faults), strict=True))
    surprising = [fault for fault, wrongly in hasty.items() if wrongly]
    patient = {fault: misjudged(role, fault, PATIENCE) for fault in surprising}
    assert {fault or "no fault": wrongly for fault, wrongly in patient.items() if wrongly} == {}


@pytest.mark.parametrize("role", THREE_ROLES)
def test_a_fault_of_each_tier_breaks_its_own_rule_and_no_other(role: Role) -> None:
    tiers = {rule.name: rule.tier for rule in rules_of(role)}
    judge_all(role, list({tiers[rule]: fault for fault, rule in FAULTS[role].items()}.values()))


@pytest.mark.stage("conformance")
@pytest.mark.proof
@pytest.mark.timeout(900)
@pytest.mark.parametrize("role", THREE_ROLES)
def test_each_fault_breaks_its_own_rule_and_no_other(role: Role) -> None:
    judge_all(role, ["", *ODDITIES, *FAULTS[role]])


def test_there_are_many_faults_and_each_rule_is_broken_by_one() -> None:
    assert len([changed(RIGHT, row) for row in TABLE.values()]) > 80
    broken = {rule for faults in FAULTS.values() for rule in faults.values()}
    assert broken == {rule.name for role in THREE_ROLES for rule in rules_of(role)}
