"""Our own clients keep every rule of the kit that judges clients, and so does the example in C."""

from __future__ import annotations

from pathlib import Path

import pytest

from glue.conform.clients.judge import judge
from glue.conform.clients.process import starter
from glue.conform.report import line
from glue.conform.rules import Outcome, Requirement
from glue.wire.messages import THREE_ROLES, Role
from tests.cc import compiled
from tests.glue.conform.forked import ENDS, QUIET, WAIT, mirror, slow_to_close
from tests.proof import size

EXAMPLE = Path(__file__).parents[3] / "docs/examples/c/mirror.c"


@pytest.mark.proof
@pytest.mark.parametrize("role", THREE_ROLES)
@pytest.mark.parametrize(("transport", "libzmq"), size(ENDS[:1], ENDS))
def test_our_own_clients_keep_every_rule(role: Role, transport: str, libzmq: bool) -> None:
    verdicts = [*judge(role, mirror(role, libzmq), transport=transport, wait=WAIT, quiet=QUIET)]

    unjudged = {verdict.rule.name for verdict in verdicts if verdict.outcome is Outcome.NOT_JUDGED}
    assert unjudged <= {"idle", "batch"}
    assert [line(verdict) for verdict in verdicts if verdict.outcome is Outcome.FAILED] == []


@pytest.mark.stage("conformance")
def test_a_client_that_reconnects_while_it_ends_is_judged_by_its_end() -> None:
    start = slow_to_close(Role.EXPERIMENT)
    (verdict,) = judge(Role.EXPERIMENT, start, transport="ipc", wait=WAIT, only={"malformed-bodies"})

    assert verdict.outcome is Outcome.PASSED, line(verdict)


def test_a_client_that_takes_its_time_to_leave_after_an_error_is_judged_by_its_deed() -> None:
    some = {"exception", "max-body"}
    verdicts = [*judge(Role.AGENT, mirror(Role.AGENT, False), wait=WAIT, quiet=0.0, only=some)]

    assert [line(verdict) for verdict in verdicts if verdict.outcome is not Outcome.PASSED] == []


@pytest.fixture(scope="module")
def c_mirror(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return compiled(EXAMPLE, tmp_path_factory.mktemp("c"))


@pytest.mark.stage("conformance")
@pytest.mark.proof
@pytest.mark.parametrize("transport", size(["ipc"], ["tcp", "ipc"]))
def test_the_example_in_c_keeps_every_rule(c_mirror: Path, transport: str) -> None:
    verdicts = [*judge(Role.AGENT, starter([str(c_mirror)]), transport=transport, wait=WAIT, quiet=QUIET)]

    unkept = [v for v in verdicts if v.outcome is not Outcome.PASSED and v.rule.level is not Requirement.MAY]
    assert [line(verdict) for verdict in unkept] == []
