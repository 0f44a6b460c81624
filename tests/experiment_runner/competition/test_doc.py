"""docs/competition.md and docker/example/competition.toml: their files are read, and their commands run."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from experiment_runner.cli.compete import compete
from experiment_runner.competition.file import load_competition, parse_competition
from experiment_runner.competition.secret import trials
from experiment_runner.competition.settings import Limits
from glue.cli.keys import keys
from tests.house.imports import ROOT
from tests.proof import FULL

PAGE = (ROOT / "docs" / "competition.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"^```(\w+)\n(.*?)^```$", PAGE, re.M | re.S)
SCRIPTS = [body for language, body in BLOCKS if language == "sh"]
EXAMPLE = ROOT / "docker" / "example" / "competition.toml"
GROUPS = {"glue-compete": compete, "glue-keys": keys}


def test_the_file_of_the_page_is_a_competition_with_the_limits_that_there_are_by_default() -> None:
    (text,) = (body for language, body in BLOCKS if language == "toml")
    competition = parse_competition(text, Path("spring.toml"))
    assert set(tomllib.loads(text)["limits"]) == {
        *(field for field in Limits.__dataclass_fields__ if field != "time"),
        *competition.limits.time.__dataclass_fields__,
    }
    assert competition.limits == Limits()
    assert [entrant.name for entrant in competition.entrants] == ["alice", "bob", "carol"]


def test_the_example_is_a_competition_of_what_is_here() -> None:
    competition = load_competition(EXAMPLE)
    levels = {
        spec.environment.options.get("level_seed")
        for spec in trials(competition, b"xyzzy")
        if spec.environment and spec.environment.label == "unseen"
    }
    assert len(levels) == competition.trials == 2


@pytest.mark.parametrize("script", SCRIPTS)
def test_commands_have_the_options_that_they_are_given(script: str) -> None:
    lines = [line for line in script.splitlines() if line.startswith(tuple(GROUPS))]
    for line in lines:
        name, command, *arguments = line.partition("#")[0].partition(">")[0].split()
        found = GROUPS[name].commands[command]
        found.make_context(command, arguments)


@pytest.mark.timeout(900)
@pytest.mark.proof
@pytest.mark.skipif(not FULL, reason="proved by `make proof` alone")
def test_the_page_can_be_followed(tmp_path: Path) -> None:
    (tmp_path / "docker" / "example").mkdir(parents=True)
    shutil.copy(EXAMPLE, tmp_path / "docker" / "example")
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
    done = subprocess.run(
        ["bash", "-euo", "pipefail", "-c", SCRIPTS[0]],
        cwd=tmp_path,
        env={**os.environ, "PATH": path},
        capture_output=True,
        text=True,
        timeout=880,
    )
    assert done.returncode == 0, done.stderr
    assert "12 of 12 trials are verified" in done.stderr
    for entrant in ("random", "sample", "hierarchical"):
        assert entrant in done.stdout
        assert "3 episodes of the environment mario" in (tmp_path / f"check/{entrant}/report.txt").read_text()
    assert "level_seed" in (tmp_path / "board.html").read_text()
