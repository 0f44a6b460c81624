"""Our own clients survive scripts of random faults: apart from the rules, as a module runs in one process."""

from __future__ import annotations

import pytest

from glue.conform.clients.judge import judge_scripts
from glue.conform.report import line
from glue.conform.rules import Outcome
from glue.wire.messages import THREE_ROLES, Role
from tests.glue.conform.forked import ENDS, mirror
from tests.proof import size

pytestmark = pytest.mark.stage("conformance")


@pytest.mark.proof
@pytest.mark.parametrize("role", THREE_ROLES)
@pytest.mark.parametrize(("transport", "libzmq"), size(ENDS[:1], ENDS))
def test_our_own_clients_survive_random_faults(role: Role, transport: str, libzmq: bool) -> None:
    # After each failed handshake libzmq waits longer: a script takes up to half a minute.
    seeds = range(3 if libzmq else size(5, 30))
    verdicts = [*judge_scripts(role, mirror(role, libzmq), seeds, transport=transport, wait=60)]

    assert [verdict.rule.name for verdict in verdicts] == [f"seed-{seed}" for seed in seeds]
    assert [line(verdict) for verdict in verdicts if verdict.outcome is not Outcome.PASSED] == []
