"""docs/legacy.md says what is so: its limits, its ids, its commands and its log lines."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import click
import pytest

from experiment_runner.commands.experiment import experiment
from glue.hub.command import hub
from glue.legacy import codec, peers, pending
from tests.system.legacy.legacy_client import Id
from tests.system.legacy.legacy_rig import gateway

TEXT = (Path(__file__).parents[3] / "docs" / "legacy.md").read_text(encoding="utf-8")
COMMANDS: dict[str, click.Command] = {"glue-hub": hub, "glue-experiment": experiment}
EXAMPLES = [line.strip() for line in TEXT.splitlines() if line.startswith("    glue-")]


@pytest.mark.parametrize("example", EXAMPLES)
def test_an_example_is_understood(example: str) -> None:
    name, *arguments = shlex.split(example)
    context = COMMANDS[name].make_context(name, arguments)
    assert context.params["legacy_port"]


@pytest.mark.parametrize(
    ("what", "limit"),
    [
        ("ints, doubles, chars", codec.MAX_COUNT),
        ("a task spec or message", codec.MAX_TEXT),
        ("bytes in a payload beyond", codec.SURPLUS),
        ("requests that an experiment sends ahead", peers.READ_AHEAD),
        ("connections that have not said", pending.MAX_PENDING),
    ],
)
def test_a_limit_is_the_one_that_holds(what: str, limit: int) -> None:
    (row,) = re.findall(rf"^\| {what}[^|]*\|([^|]*)\|", TEXT, re.MULTILINE)
    assert int(row.split()[0].replace(",", "")) == limit


def test_the_refused_ids_are_none_of_ours() -> None:
    (row,) = re.findall(r"^\| message ids ([^|]*)\|", TEXT, re.MULTILINE)
    refused: set[int] = set()
    for part in row.split(","):
        first, _, last = part.strip().partition("-")
        refused |= set(range(int(first), int(last or first) + 1))
    assert refused == codec._KINDS_OF_2
    spoken = (codec.HANDSHAKE, codec.FROM_AGENT, codec.FROM_ENVIRONMENT, codec.FROM_EXPERIMENT)
    assert not refused & {int(kind) for vocabulary in spoken for kind in vocabulary}


def test_the_log_looks_as_shown() -> None:
    with gateway() as rig:
        agent = rig.connect()
        agent.send(Id.AGENT_CONNECTION)
        rig.log.wait_for("joined")
        agent.close()
        rig.log.wait_for("closed its connection")
        logged = re.sub(r":\d+ ", ":41360 ", str(rig.log))
    shown = re.findall(r"^    (session .*)$", TEXT, re.MULTILINE)
    assert logged.splitlines() == shown
