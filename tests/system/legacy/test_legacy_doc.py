"""docs/legacy.md is true: its limits, ids, commands, examples, log lines and promises."""

from __future__ import annotations

import re
import shlex
from contextlib import closing
from pathlib import Path

import click
import pytest

from agents.mario.runner import RunRightAgent
from experiment_runner.cli.experiment import experiment
from glue.cli.hub import hub
from glue.legacy import bodies, codec, pending
from glue.legacy.experiment import READ_AHEAD
from tests.pages import DOCS, section
from tests.system.legacy.legacy_client import STYLES, Connection, Id, play
from tests.system.legacy.legacy_rig import gateway
from tests.terminal import Terminal

TEXT = (DOCS / "legacy.md").read_text(encoding="utf-8")
COMMANDS: dict[str, click.Command] = {"glue-hub": hub, "glue-experiment": experiment}
TIME = r"[\d-]+ [\d:]+"
NUMBER = r"\d+"
BIND = ("--bind", "tcp://127.0.0.1:*")
EXAMPLES = re.findall(r"^    (?:\$ )?(glue-.*)$", TEXT, re.MULTILINE)


@pytest.mark.parametrize("example", EXAMPLES)
def test_an_example_is_understood(example: str) -> None:
    name, *arguments = shlex.split(example)
    context = COMMANDS[name].make_context(name, arguments)
    assert context.params["legacy_port"] or context.params["hub"]


@pytest.mark.parametrize(
    ("what", "limit"),
    [
        ("ints, doubles, chars", bodies.MAX_COUNT),
        ("a task spec or message", bodies.MAX_STRING),
        ("bytes in a payload beyond", codec.SURPLUS),
        ("requests that an experiment sends ahead", READ_AHEAD),
        ("connections without a role", pending.MAX_PENDING),
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
    spoken = (codec.HANDSHAKE, *codec.FROM.values())
    assert not refused & {int(kind) for vocabulary in spoken for kind in vocabulary}


def anonymous(line: str) -> str:
    """Return a line of the log with the client's port replaced by that of the document."""
    return re.sub(r"127\.0\.0\.1:\d+\)", "127.0.0.1:41360)", line)


def test_the_log_looks_as_shown() -> None:
    with gateway() as rig:
        agent = rig.connect()
        agent.send(Id.AGENT_CONNECTION)
        rig.log.wait_for("joined")
        agent.close()
        rig.log.wait_for("closed its connection")
    shown = re.findall(
        rf"^    {TIME} (session .*)$", section(TEXT, "What differs from the original server"), re.MULTILINE
    )
    assert [anonymous(line) for line in str(rig.log).splitlines()] == shown


COMPILATION = 300.0
"""Seconds allowed for compiling the simulator at its first start, even on a busy machine."""


@pytest.mark.stage("docs")
def test_the_mixed_example_runs_as_shown(tmp_path: Path) -> None:
    text = section(TEXT, "An example: an original agent on our Mario")
    first, second, alone = (
        re.sub("4096|5096", "*", command) for command in re.findall(r"^    \$ (glue-.*)$", text, re.MULTILINE)
    )
    hub = Terminal(*shlex.split(first), *BIND, cwd=tmp_path)
    with closing(hub):
        found = [
            hub.wait_for("^" + re.sub("4097|4096|5096", r"(\\d+)", re.escape(line)) + "$")[1]
            for line in re.findall(r"^    (listening .*)$", text, re.MULTILINE)
        ]
        second = second.replace("4097", found[0])
        with closing(Terminal(*shlex.split(second), cwd=tmp_path)) as experiment:
            play(RunRightAgent(), Connection(int(found[2]), STYLES["java"], timeout=COMPILATION))
            assert experiment.end() == 0
            experiment.wait_for(r"/mario/0 .* 3/3 ")
        for line in re.findall(rf"^    {TIME} (session .*)$", text, re.MULTILINE):
            hub.wait_for(rf"^{TIME} {re.escape(line).replace('41360', NUMBER)}")
    with closing(Terminal(*shlex.split(alone), *BIND, "--out", "alone", cwd=tmp_path)) as experiment:
        port = int(experiment.wait_for(r"programs .*on 127\.0\.0\.1:(\d+)")[1])
        play(RunRightAgent(), Connection(port, STYLES["c"]))
        assert experiment.end() == 0
