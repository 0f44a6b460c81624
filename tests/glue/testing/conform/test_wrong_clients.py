"""The kit finds faults: clients with one fault each break exactly one rule, and keep all others."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor

import pytest

from glue.protocol.messages import THREE_ROLES, Role
from glue.testing.conform.judge import Outcome, Verdict, judge, rules_of
from glue.testing.conform.report import line
from tests.glue.testing.conform.forked import wrong
from tests.glue.testing.conform.wrong import FAULTS
from tests.proof import size

COMMON = {"hello", "calls", "repeated", "numbers"}
"""Rules by which each client is judged in any case, beside its own; `make proof` judges it by all."""

CASES = [(role, fault) for role, faults in FAULTS.items() for fault in ("", *faults)]

Judged = dict[tuple[str, str], "Future[list[Verdict]]"]


@pytest.fixture(scope="module")
def judged() -> Iterator[Judged]:
    """The verdicts on every client; they mostly wait, so several are judged at a time."""
    with ThreadPoolExecutor(10) as pool:
        yield {(role, fault): pool.submit(verdicts_on, role, fault) for role, fault in CASES}


def verdicts_on(role: str, fault: str) -> list[Verdict]:
    rule = FAULTS[role].get(fault)
    some = None if rule is None else {rule, *COMMON}
    # A client that does nothing is waited for in vain: long enough for a busy machine, not longer.
    return judge(Role(role), wrong(Role(role), fault), wait=4, only=size(some, None))


@pytest.mark.proof
@pytest.mark.parametrize(("role", "fault"), CASES)
def test_a_fault_breaks_its_own_rule_and_no_other(judged: Judged, role: str, fault: str) -> None:
    verdicts = judged[role, fault].result()
    failed = [verdict for verdict in verdicts if verdict.outcome is Outcome.FAILED]
    unjudged = [verdict for verdict in verdicts if verdict.outcome is Outcome.NOT_JUDGED]
    rule = FAULTS[role].get(fault)

    assert [verdict.rule.name for verdict in failed] == ([rule] if rule else []), list(map(line, failed))
    # What rests on the broken rule need not be judged, everything else is.
    assert {verdict.rule.name for verdict in unjudged if rule not in verdict.rule.needs} == set()


def test_there_are_many_faults_and_each_rule_is_broken_by_one() -> None:
    assert sum(map(len, FAULTS.values())) > 60
    broken = {rule for faults in FAULTS.values() for rule in faults.values()}
    assert broken == {rule.name for role in THREE_ROLES for rule in rules_of(role)}
