"""docs/paper.md shows a complete study, and its commands are valid."""

from __future__ import annotations

import re
import shlex
from pathlib import Path
from typing import Final

from experiment_runner.cli.paper import paper
from experiment_runner.study.paper.experiments import ALL, EXPERIMENTS
from experiment_runner.study.paper.report import BEGIN, END

DOCS: Final = Path(__file__).parents[4] / "docs"
TEXT: Final = (DOCS / "paper.md").read_text(encoding="utf-8")
TABLES: Final = TEXT.partition(BEGIN)[2].partition(END)[0]


def test_every_call_of_the_command_is_understood() -> None:
    calls = [shlex.split(line, comments=True) for line in TEXT.splitlines() if line.startswith("glue-paper")]
    assert len(calls) > 3
    for name, *arguments in calls:
        paper.make_context(name, arguments)


def test_tables_are_of_finished_trials_of_every_experiment_of_the_paper() -> None:
    studied = [experiment for experiment in EXPERIMENTS.values() if experiment.group == ALL]
    agents = {sweep.label for experiment in studied for sweep in experiment.agents}
    shown = set(re.findall(r"^\|[^|]+\| `([\w-]+)` \|", TABLES, re.MULTILINE))
    assert agents <= shown <= agents
    assert "trials)" not in TABLES
