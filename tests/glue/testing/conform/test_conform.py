"""The kit that judges clients: our own clients pass it."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from glue.protocol.messages import Role
from glue.testing.conform.judge import Outcome, judge, rules_of
from glue.testing.conform.report import line
from tests.glue.testing.conform.forked import mirror

DOCS = Path(__file__).parents[4] / "docs"


@pytest.mark.parametrize("role", list(Role))
def test_our_own_clients_keep_every_rule(role: Role) -> None:
    verdicts = judge(role, mirror(role, libzmq=False), transport="tcp", wait=20)

    unjudged = {verdict.rule.name for verdict in verdicts if verdict.outcome is Outcome.NOT_JUDGED}
    assert unjudged <= {"idle"}
    assert [line(verdict) for verdict in verdicts if verdict.outcome is Outcome.FAILED] == []


def test_every_rule_stands_in_the_protocol() -> None:
    text = (DOCS / "protocol.md").read_text(encoding="utf-8")
    headings = re.findall(r"^#+ (.*)$", text, re.MULTILINE)
    anchors = {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}

    for role in Role:
        rules = rules_of(role)
        assert {rule.section for rule in rules} <= anchors
        assert len({rule.name for rule in rules}) == len(rules) > 30
