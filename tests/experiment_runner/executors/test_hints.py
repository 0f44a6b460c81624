"""The lines of an experiment that waits."""

from __future__ import annotations

from experiment_runner.executors.hints import Hints
from glue.wire.messages import Role

BOTH = frozenset({Role.AGENT, Role.ENVIRONMENT})


def test_player_that_starts_by_itself_is_mentioned_once() -> None:
    lines: list[str] = []
    hints = Hints(lines.append, "tcp://127.0.0.1:9", "a", BOTH)
    for missing in (BOTH, {Role.AGENT}, BOTH):
        hints.show(missing)
    assert lines == ["waiting for the agent to start", "waiting for the environment to start"]


def test_command_for_a_player_from_outside_is_repeated() -> None:
    lines: list[str] = []
    hints = Hints(lines.append, "tcp://0.0.0.0:9", "a", {Role.ENVIRONMENT})
    hints.show(BOTH)
    hints.show({Role.AGENT})
    assert lines[0] == lines[2]
    assert lines[0].endswith("in another terminal: glue-agent hierarchical --hub tcp://HOST:9 --session a")
    assert lines[1] == "waiting for the environment to start"
    assert len(lines) == 3
