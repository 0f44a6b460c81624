"""Players in processes that the experiment starts."""

from __future__ import annotations

from pathlib import Path

from tests.forked import run

AGENT = """
from agents.baselines import RandomAgent
from glue.console import say_why_slow


class Slow(RandomAgent):
    def agent_init(self, task_spec: str) -> None:
        say_why_slow("compiling its policy")
        super().agent_init(task_spec)
"""


def test_a_player_that_compiles_says_so_once_in_the_terminal_of_the_experiment(tmp_path: Path) -> None:
    (tmp_path / "slow.py").write_text(AGENT, encoding="utf-8")
    shown = run(
        *("glue-experiment", "--env", "mines", "--agent", "slow.py:Slow", "--episodes", "1"), cwd=tmp_path
    )
    assert shown.returncode == 0, shown.stderr
    assert shown.stderr.count("compiling its policy") == 1
    assert "agent Slow: compiling its policy" in shown.stderr.splitlines()
