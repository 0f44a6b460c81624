"""The kit that judges clients and hubs, and its command."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from env_server.toys import MinesEnvironment
from glue.cli.conform import conform as command
from glue.conform.clients.judge import judge, judge_scripts, rules_of
from glue.conform.clients.mirror import MirrorAgent, MirrorEnvironment
from glue.conform.report import line, reached, summary
from glue.conform.rules import Outcome, Tier
from glue.hub.config import HubConfig
from glue.hub.io.server import Hub
from glue.testing import HubRule
from glue.types import Action, Observation
from glue.wire.messages import THREE_ROLES, Role
from tests.forked import run
from tests.glue.conform.forked import QUIET, WAIT, mirror, served, wrong
from tests.glue.conform.wrong import FAULTS
from tests.pages import DOCS, anchors

ROOT = Path(__file__).parents[3]


@pytest.mark.stage("conformance")
@pytest.mark.parametrize(
    ("role", "fault"),
    [
        (Role.AGENT, "carries out what comes again"),
        (Role.AGENT, "keeps no bytes of an answer"),
        (Role.AGENT, "answers ahead of WELCOME"),
        (Role.EXPERIMENT, "asks ahead of WELCOME"),
    ],
)
def test_random_faults_find_a_wrong_client(role: Role, fault: str) -> None:
    verdicts = [*judge_scripts(role, wrong(role, fault), range(6), transport="ipc", wait=20)]

    expected = [verdict.expected for verdict in verdicts if verdict.outcome is Outcome.FAILED]
    assert any(", after " in text for text in expected)


@pytest.mark.stage("conformance")
def test_any_agent_survives_random_faults() -> None:
    verdicts = [*judge_scripts(Role.AGENT, served(Walker()), range(2), transport="ipc", wait=WAIT)]

    assert {verdict.outcome for verdict in verdicts} == {Outcome.PASSED}


@pytest.mark.stage("conformance")
def test_a_script_is_replayed_by_its_seed() -> None:
    command = (sys.executable, "-m", "glue.testing.mirror", "agent")
    for options, passed in ((("--seeds", "2"), 2), (("--seed", "1"), 1)):
        done = conform("agent", *options, "--transport", "ipc", "--wait", "20", "--", *command)
        assert (done.returncode, done.stdout) == (0, f"survives ({passed} passed)\n"), done.stderr


def test_every_rule_stands_in_the_protocol() -> None:
    for role in THREE_ROLES:
        rules = rules_of(role)
        assert {rule.section for rule in rules} <= anchors(DOCS / "protocol-reference.md")
        assert len({rule.name for rule in rules}) == len(rules) > 30


def test_the_mirrors_agent_answers_as_the_page_says() -> None:
    agent = MirrorAgent()
    agent.agent_init("")
    agent.agent_start(Observation([1]))
    action = agent.agent_step(-1.0, Observation([3, -5], [0.5], b"ab"))
    assert action == Action([-5, 3, 2], [0.5, -2.0, -1.0], b"ba")
    assert agent.agent_step(1.0, Observation()) == Action()
    assert agent.agent_save() == b"3 0"


def test_the_mirrors_environment_rewards_and_ends_as_its_action_says() -> None:
    environment = MirrorEnvironment()
    environment.env_init()
    assert environment.env_start() == Observation([1])
    shown = Observation([7, 2], [2.0, -0.5, 7.0], b"!a")
    assert environment.env_step(Action([7], [-0.5, 2.0], b"a!"))[:3] == (-0.5, shown, True)
    assert str(environment.env_step(Action(doubles=[-0.0]))[0]) == "-0.0"
    assert environment.env_step(Action())[:3] == (0.0, Observation(), False)


class Walker:
    """A minimal agent."""

    def agent_start(self, observation: Observation) -> Action:
        return Action([1])

    def agent_step(self, reward: float, observation: Observation) -> Action:
        return Action([1 if 0 <= observation.ints[0] <= 20 else 0])


class RefusesMessages(Walker):
    def agent_message(self, message: str) -> str:
        raise ValueError("no messages, please")


class Echo(Walker):
    def agent_message(self, message: str) -> str:
        return message


@pytest.mark.stage("conformance")
@pytest.mark.parametrize(("role", "make"), [(Role.AGENT, Walker), (Role.ENVIRONMENT, MinesEnvironment)])
def test_any_player_is_judged_by_what_does_not_rest_on_its_answers(
    role: Role, make: type[Walker] | type[MinesEnvironment]
) -> None:
    verdicts = [*judge(role, served(make()), transport="ipc", wait=WAIT, quiet=QUIET)]

    unjudged = [v.rule for v in verdicts if v.outcome is Outcome.NOT_JUDGED]
    assert [line(verdict) for verdict in verdicts if verdict.outcome is Outcome.FAILED] == []
    assert all(rule.mirror or rule.capability or rule.name == "idle" for rule in unjudged)
    assert len(verdicts) - len(unjudged) > 30
    assert summary(verdicts).startswith("plays, as far as can be told without the mirror; survives; complete")


def test_a_player_that_fails_in_a_legal_call_is_found_without_the_mirror() -> None:
    verdicts = [*judge(Role.AGENT, served(RefusesMessages()), wait=WAIT, only={"calls"})]

    assert [verdict.outcome for verdict in verdicts] == [Outcome.FAILED]
    assert "no messages, please" in verdicts[0].received


def test_the_mirror_is_told_by_its_declared_name_or_by_the_option_and_not_by_its_answers() -> None:
    expected = {"": Outcome.NOT_JUDGED, "a mirror": Outcome.NOT_JUDGED, "mirror": Outcome.FAILED}
    for name, outcome in expected.items():
        start = served(Echo(), name)
        (ints,) = judge(Role.AGENT, start, wait=WAIT, only={"ints"})
        assert ints.outcome is outcome, name
    (ints,) = judge(Role.AGENT, served(Echo()), mirror=True, wait=WAIT, only={"ints"})
    assert ints.outcome is Outcome.FAILED


@pytest.mark.parametrize(
    ("fault", "conforms"), [("ignores WELCOME's heartbeat", True), ("answers no PING", False)]
)
def test_only_a_broken_must_costs_the_tier(fault: str, conforms: bool) -> None:
    verdicts = [*judge(Role.AGENT, wrong(Role.AGENT, fault), wait=1, only={FAULTS["agent"][fault]})]

    assert [verdict.outcome for verdict in verdicts] == [Outcome.FAILED]
    assert all(reached(verdicts).values()) is conforms
    assert line(verdicts[0]).startswith("should" if conforms else "FAILED")


def test_a_hub_is_judged_by_its_address() -> None:
    with Hub(HubConfig(bind=("tcp://127.0.0.1:*",), timeout=0.3, heartbeat=0.1)).in_background() as hub:
        done = conform("hub", "--json", hub.endpoints[0])
    found = json.loads(done.stdout)

    assert (done.returncode, found["role"]) == (0, "hub")
    assert {rule["outcome"] for rule in found["rules"]} == {"passed"}
    assert len(found["rules"]) == len(HubRule)


def conform(*arguments: str) -> subprocess.CompletedProcess[str]:
    return run("glue-conform", *arguments, cwd=ROOT)


def test_the_command_prints_json_and_writes_a_scorecard(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    card = tmp_path / "card.md"
    client = ("./mirror", "agent")
    # The command's clients, forked: each would start for half a second otherwise, and there are fifteen.
    monkeypatch.setattr("glue.cli.conform.starter", {client: mirror(Role.AGENT, False)}.__getitem__)
    options = ("--tier", "plays", "--transport", "tcp", "--wait", "20", "--json", "--scorecard", str(card))
    status = command.main(["agent", *options, "--", *client], standalone_mode=False)

    printed = capsys.readouterr()
    found = json.loads(printed.out)
    plays = {rule.name for rule in rules_of(Role.AGENT, Tier.PLAYS)}
    assert (status, found["command"], found["tiers"]) == (0, [*client], {"plays": True})
    assert {rule["name"] for rule in found["rules"] if rule["outcome"] == "passed"} == plays
    assert all(f"| [{name}](docs/protocol-reference.md#" in card.read_text() for name in plays)
    assert "| plays | yes |" in card.read_text()
    assert f"wrote {card}" in printed.err


def test_a_client_that_does_not_connect_is_said_to() -> None:
    options = ("--tier", "plays", "--transport", "tcp", "--wait", "0.1")
    done = conform("environment", *options, "--", sys.executable, "-c", "raise SystemExit('no hub for me')")

    assert done.returncode == 1
    assert "FAILED tcp  plays     MUST    handshake" in done.stdout
    assert "no hub for me" in done.stdout
    assert "plays: no" in done.stdout


def test_a_mistake_of_the_user_is_one_line() -> None:
    for arguments, words in (
        (("agent", "--", "./no-such-program"), "no-such-program"),
        (("hub", "tcp://127.0.0.1:1", "another"), "by its address alone"),
        (("hub", "--seeds", "2", "tcp://127.0.0.1:1"), "scripts of faults are for clients"),
        (("agent", "--seed", "1", "--seeds", "2", "--", "x"), "scripts of faults are for clients"),
    ):
        done = conform(*arguments)
        assert (done.returncode, done.stdout) == (2, "")
        assert words in done.stderr
        assert "Traceback" not in done.stderr
