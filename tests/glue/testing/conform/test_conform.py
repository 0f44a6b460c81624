"""The kit that judges clients: our own clients pass it."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from glue.protocol.messages import THREE_ROLES, Role
from glue.testing.conform.hub.clients import starter
from glue.testing.conform.hub.rules import Tier
from glue.testing.conform.judge import Outcome, judge, rules_of
from glue.testing.conform.report import line
from tests.glue.testing.conform.forked import mirror
from tests.proof import size

ENDS = [("tcp", False), ("ipc", True), ("ipc", False), ("tcp", True)]
"""Transports, each with plain sockets or with libzmq."""

ROOT = Path(__file__).parents[4]
DOCS = ROOT / "docs"


@pytest.mark.proof
@pytest.mark.parametrize("role", THREE_ROLES)
@pytest.mark.parametrize(("transport", "libzmq"), size(ENDS[:1], ENDS))
def test_our_own_clients_keep_every_rule(role: Role, transport: str, libzmq: bool) -> None:
    verdicts = judge(role, mirror(role, libzmq), transport=transport, wait=20)

    unjudged = {verdict.rule.name for verdict in verdicts if verdict.outcome is Outcome.NOT_JUDGED}
    assert unjudged <= {"idle"}
    assert [line(verdict) for verdict in verdicts if verdict.outcome is Outcome.FAILED] == []


def test_every_rule_stands_in_the_protocol() -> None:
    text = (DOCS / "protocol.md").read_text(encoding="utf-8")
    headings = re.findall(r"^#+ (.*)$", text, re.MULTILINE)
    anchors = {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}

    for role in THREE_ROLES:
        rules = rules_of(role)
        assert {rule.section for rule in rules} <= anchors
        assert len({rule.name for rule in rules}) == len(rules) > 30


@pytest.fixture(scope="module")
def c_mirror(tmp_path_factory: pytest.TempPathFactory) -> Path:
    compiler = shutil.which("cc")
    if compiler is None:
        pytest.skip("there is no C compiler here to build the C mirror")
    includes = subprocess.run([compiler, "-E", "-"], input=b"#include <zmq.h>\n", capture_output=True)
    if includes.returncode != 0:
        pytest.skip("there is no zmq.h here to build the C mirror (Debian: libzmq3-dev)")
    program = tmp_path_factory.mktemp("c") / "mirror"
    strict = ["-std=c11", "-Wall", "-Wextra", "-Werror"]
    source = str(DOCS / "examples/c/mirror.c")
    subprocess.run([compiler, *strict, "-o", str(program), source, "-lzmq"], check=True)
    return program


@pytest.mark.proof
@pytest.mark.parametrize("transport", size(["ipc"], ["tcp", "ipc"]))
def test_the_example_in_c_keeps_every_rule(c_mirror: Path, transport: str) -> None:
    verdicts = judge(Role.AGENT, starter([str(c_mirror)]), transport=transport, wait=20)

    assert [line(verdict) for verdict in verdicts if verdict.outcome is not Outcome.PASSED] == []


PROGRAM = "from glue.testing.conform.entry import conform; conform()"


def conform(*arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-c", PROGRAM, *arguments]
    return subprocess.run(command, capture_output=True, text=True, timeout=120, cwd=ROOT)


def test_the_command_prints_json_and_writes_a_scorecard(tmp_path: Path) -> None:
    card = tmp_path / "card.md"
    client = (sys.executable, "-m", "glue.testing.mirror", "agent")
    options = ("--tier", "plays", "--transport", "tcp", "--wait", "20", "--json", "--scorecard", str(card))
    done = conform("agent", *options, "--", *client)

    found = json.loads(done.stdout)
    plays = {rule.name for rule in rules_of(Role.AGENT, Tier.PLAYS)}
    assert (done.returncode, found["tiers"]) == (0, {"plays": True})
    assert {rule["name"] for rule in found["rules"] if rule["outcome"] == "passed"} == plays
    assert all(f"| [{name}](docs/protocol.md#" in card.read_text() for name in plays)
    assert "| plays | yes |" in card.read_text()
    assert f"wrote {card}" in done.stderr


def test_a_client_that_does_not_connect_is_said_to() -> None:
    options = ("--tier", "plays", "--transport", "tcp", "--wait", "0.5")
    done = conform("environment", *options, "--", sys.executable, "-c", "raise SystemExit('no hub for me')")

    assert done.returncode == 1
    assert "FAILED tcp  plays     handshake" in done.stdout
    assert "no hub for me" in done.stdout
    assert "plays: no" in done.stdout


def test_a_program_that_is_not_there_is_a_mistake_of_the_user() -> None:
    done = conform("agent", "--", "./no-such-program")

    assert (done.returncode, done.stdout) == (2, "")
    assert "no-such-program" in done.stderr
    assert "Traceback" not in done.stderr
