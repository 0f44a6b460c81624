"""Pages that can be followed: every command and program on them runs, in order, in one folder."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Final

import pytest

from experiment_runner.plan.file import load_plan
from experiment_runner.store.results import Results
from tests.pages import DOCS, blocks, follow, run_examples
from tests.system.runs import contents

pytestmark = [pytest.mark.stage("docs"), pytest.mark.slow]

EXAMPLES: Final = {"gymnasium": 15, "mario": 12}
"""Pages with interpreter sessions, and how many lines they have at least."""


def text_of(page: str) -> str:
    """Return a page's text with 20 episodes instead of hundreds."""
    text = (DOCS / f"{page}.md").read_text(encoding="utf-8")
    return re.sub(r"(?<=episodes )[12]00\b|(?<=episodes = )[12]00\b", "20", text)


@pytest.mark.parametrize("page", ["experiments", "first-agent", "first-experiment", "first-competition"])
def test_every_block_has_a_part_in_it(page: str) -> None:
    parts = r"file: \S+|runs in the tests(, where \w+ (is|are) installed)?"
    assert [block for block in blocks(text_of(page)) if not re.fullmatch(parts, block.note)] == []


def test_experiments(tmp_path: Path) -> None:
    follow(text_of("experiments"), tmp_path)
    for name in ("first.csv", "first.png", "sweep.png", "sweep.svg", "sweep.parquet"):
        assert (tmp_path / name).stat().st_size > 0, name
    for run in ("first", "trials", "try", "sweep", "killed", "both"):
        with Results.open(tmp_path / "runs" / run) as results:
            assert all(trial.finished for trial in results.trials()), run
    # The run continues after the kill; had it ended before, the text would show nothing.
    with Results.open(tmp_path / "runs" / "killed") as results:
        assert [event.kind for event in results.events()][:2] == ["start", "resume"]
    assert "sarsa/mines/3" in contents(tmp_path / "runs" / "trials")
    assert len(load_plan(tmp_path / "sweep.toml").expand()) == len(contents(tmp_path / "runs/sweep")) == 12


@pytest.mark.parametrize(
    ("page", "made"),
    [
        ("first-agent", "first.png"),
        ("first-experiment", "compare.png"),
        ("first-competition", "board.html"),
        ("notebooks", "."),
        ("mario", "runs/levels/results.sqlite"),
        ("masks", "hops.png"),
        ("realtime", "runs/delayed/results.sqlite"),
    ],
)
def test_tutorial(page: str, made: str, tmp_path: Path) -> None:
    follow(text_of(page).replace("episodes = 5\n", "episodes = 1\n"), tmp_path)  # of the competition's Mario
    assert (tmp_path / made).stat().st_size > 0


def test_a_stand_in_for_a_language_model_reaches_the_goal(tmp_path: Path) -> None:
    board = follow(text_of("language-models"), tmp_path)
    assert re.search(r"^\s*1\s+model\b", board, re.MULTILINE), board
    with Results.open(tmp_path / "runs/model") as results:
        assert [episode.episode_return for episode in results.episodes("chat/mines/0")] == [-11.0] * 2


def test_recordings_become_datasets(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("pyarrow", reason="needs pyarrow: pip install 'glue-rl[parquet]'")
    pytest.importorskip("minari", reason="needs Minari: pip install 'glue-rl[minari]'")
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path / "datasets"))
    text = text_of("trajectories")
    *_, learned, _ = follow(text, tmp_path).splitlines()
    assert f"# {learned}\n" in text


@pytest.mark.parametrize("page", EXAMPLES)
def test_interpreter_sessions_are_as_shown(page: str) -> None:
    pytest.importorskip("gymnasium", reason="needs Gymnasium: pip install 'glue-rl[gym]'")
    assert run_examples(text_of(page)) >= EXAMPLES[page]
