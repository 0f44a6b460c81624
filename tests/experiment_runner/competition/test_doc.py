"""docs/competition.md and docker/example/competition.toml: their files are read, and their commands run."""

from __future__ import annotations

import shlex
import shutil
import tomllib
from pathlib import Path

import pytest

from experiment_runner.cli.compete import compete
from experiment_runner.competition.settings import Limits, load_competition, parse_competition
from experiment_runner.competition.trials import trials
from glue.cli.keys import keys
from tests.pages import DOCS, ROOT, Block, blocks, run_block

PAGE = (DOCS / "competition.md").read_text(encoding="utf-8")
SCRIPTS = blocks(PAGE, "sh")
EXAMPLE = ROOT / "docker" / "example" / "competition.toml"
GROUPS = {"glue-compete": compete, "glue-keys": keys}


def test_the_file_of_the_page_is_a_competition_with_the_limits_that_there_are_by_default() -> None:
    ((_, _, text),) = blocks(PAGE, "toml")
    competition = parse_competition(text, Path("spring.toml"))
    assert set(tomllib.loads(text)["limits"]) == set(Limits.__dataclass_fields__)
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
def test_commands_have_the_options_that_they_are_given(script: Block) -> None:
    lines = [line for line in script.body.splitlines() if line.startswith(tuple(GROUPS))]
    for line in lines:
        name, command, *arguments = shlex.split(line.partition(">")[0], comments=True)
        found = GROUPS[name].commands[command]
        found.make_context(command, arguments)


@pytest.mark.timeout(900)
@pytest.mark.proof
@pytest.mark.stage("proof")
def test_the_page_can_be_followed(tmp_path: Path) -> None:
    (tmp_path / "docker" / "example").mkdir(parents=True)
    shutil.copy(EXAMPLE, tmp_path / "docker" / "example")
    done = run_block(SCRIPTS[0], tmp_path, timeout=880)
    assert "12 of 12 trials are verified" in done.stderr
    for entrant in ("random", "sample", "hierarchical"):
        assert entrant in done.stdout
        assert "3 episodes of the environment mario" in (tmp_path / f"check/{entrant}/report.txt").read_text()
    assert "level_seed" in (tmp_path / "board.html").read_text()
