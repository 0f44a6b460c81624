from __future__ import annotations

import csv
import subprocess
import sys
from pathlib import Path

import pytest
from click.testing import CliRunner, Result

from experiment_runner.cli.paper import paper
from experiment_runner.executors.opening import open_run
from experiment_runner.store.records import EpisodeResult
from experiment_runner.store.results import Results
from experiment_runner.study.paper.experiments import EXPERIMENTS, plan_of
from experiment_runner.study.paper.report import BEGIN, END, REPORT, SOAR_BEGIN, write_report
from glue.errors import ExperimentError

FIGURES = ("figure-2", "figure-8", "figure-13", "figure-13-nearest", "curves-0", "curves-1")


def call(*arguments: object) -> Result:
    return CliRunner().invoke(paper, list(map(str, arguments)), catch_exceptions=False, standalone_mode=False)


def make(out: Path, name: str, reward: float, trials: int = 2, finished: int | None = None) -> None:
    """Make a run of an experiment whose trials have the rewards `reward`, `reward` + 1, and so on."""
    plan = plan_of(EXPERIMENTS[name], episodes=200, trials=trials)
    with open_run(out / name, plan) as store:
        for number, spec in enumerate(plan.expand()[:finished]):
            for episode in range(1, 201):
                store.record(spec.id, EpisodeResult(episode, reward + number, 300, True, 0.01))


@pytest.fixture(scope="module")
def study(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of runs, one of them unfinished, and the report on them."""
    out = tmp_path_factory.mktemp("study")
    make(out, "sample", 130.0)
    make(out, "1", 20.0)
    make(out, "4", 144.0, finished=1)
    make(out, "8", 60.0)
    write_report(out)
    return out


def test_tables_show_ours_beside_the_papers(study: Path) -> None:
    tables = (study / REPORT / "tables.md").read_text(encoding="utf-8")
    assert (
        "| 4, programmed selection | `hierarchical-programmed` (1 of 2 trials) | 121, 0 "
        "| 146.91 | 144.00 |  | 144.0 to 144.0 | about 1500 | 100 | 100 | 100 |  | 1 of 1 | 100% |"
    ) in tables
    row = next(line for line in tables.splitlines() if "`tiles-textbook`" in line)
    assert row.startswith(
        "| 1, flat, propositional | `tiles-textbook` | 121, 0 |  | 22.50 | 22.00 to 23.00 |"
    )
    titles = [line for line in tables.splitlines() if line.startswith("**")]
    assert titles == [
        "**The paper's level: seed 121, difficulty 0**",
        "**Seed 121, higher difficulties**",
        "**Other level seeds**",
    ]
    # 4 of sample, 4 of experiment 1, 1 of experiment 4, and 22 of experiment 8
    assert tables.endswith("31 trials, 2 million steps, 0.0 hours of one core.\n")


def test_csv_has_a_row_for_each_agent_and_level(study: Path) -> None:
    with (study / REPORT / "tables.csv").open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert [(row["agent"], row["level_seed"], row["level_difficulty"]) for row in rows[:6]] == [
        ("sample", "121", "0"),
        ("sample", "121", "1"),
        ("tiles", "121", "0"),
        ("tiles-textbook", "121", "0"),
        ("hierarchical-programmed", "121", "0"),
        ("objects-coarse", "121", "1"),
    ]
    four = [rows[4][name] for name in ("trials", "paper_reward", "reward", "reward_low")]
    assert four == ["1", "146.91", "144.0", ""]


def test_figures_are_those_whose_runs_are_there(study: Path) -> None:
    names = {path.name for path in (study / REPORT).iterdir()}
    assert names == {"tables.md", "tables.csv"} | {f"{n}.{e}" for n in FIGURES for e in ("png", "svg")}
    # with the sample agent, on the level of the figure
    assert "the sample agent" in (study / REPORT / "figure-13.svg").read_text(encoding="utf-8")


def test_docs_get_the_tables_between_their_marks_and_the_figures(study: Path, tmp_path: Path) -> None:
    docs = tmp_path / "paper.md"
    docs.write_text(f"before\n{BEGIN}\nold\n{END}\nafter\n", encoding="utf-8")
    done = call("--report-only", "--out", study, "--docs", docs)
    tables = (study / REPORT / "tables.md").read_text(encoding="utf-8")
    header, first = done.stdout.splitlines()[:2]
    assert header.split() == ["agent", "level", "paper", "ours", "95", "%", "interval", "trials", "finish"]
    assert first.split()[:6] == ["sample", "sample", "121,", "0", "128.48", "130.50"]
    assert max(map(len, done.stdout.splitlines())) <= 100
    for what in (study / REPORT / "tables.md", f"{len(FIGURES)} figures to {study / REPORT}", docs):
        assert f"wrote {what}" in done.stderr
    assert docs.read_text(encoding="utf-8") == f"before\n{BEGIN}\n\n{tables}\n{END}\nafter\n"
    images = {path.name for path in (docs.parent / "images" / "paper").iterdir()}
    assert images == {f"{name}.png" for name in FIGURES}


def test_agents_on_soar_have_a_section_of_their_own_beside_ours(tmp_path: Path) -> None:
    out, docs = tmp_path / "runs", tmp_path / "paper.md"
    make(out, "soar-4", 144.0)
    text = f"{BEGIN}\nours\n{END}\n{SOAR_BEGIN}\nold\n{END}\nafter\n"
    docs.write_text(text, encoding="utf-8")
    write_report(out, docs)
    tables = (out / REPORT / "tables.md").read_text(encoding="utf-8")
    row = "| soar-4, programmed selection, Soar beside ours | `{}` | 121, 0 | {} | {} |"
    assert row.format("soar-hierarchical-programmed", "146.91", "144.50") in tables
    assert row.format("hierarchical-programmed", "", "146.50") in tables
    assert docs.read_text(encoding="utf-8") == text.replace("\nold", f"\n\n{tables}")
    assert [path.name for path in (tmp_path / "images" / "paper").iterdir()] == ["soar-4.png"]


@pytest.mark.parametrize("text", ["", f"{BEGIN}\n", f"{END}\n{BEGIN}\n"])
def test_docs_without_marks_stay_as_they_are(study: Path, tmp_path: Path, text: str) -> None:
    docs = tmp_path / "paper.md"
    docs.write_text(text, encoding="utf-8")
    with pytest.raises(ExperimentError, match="must have the lines"):
        write_report(study, docs)
    assert docs.read_text(encoding="utf-8") == text


def test_report_without_episodes_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(ExperimentError, match="no finished episode"):
        write_report(tmp_path)


def test_command_runs_what_is_missing_and_reports(tmp_path: Path) -> None:
    arguments = ("7", "--trials", "1", "--episodes", "3", "--workers", "2", "--out", str(tmp_path))
    command = [sys.executable, "-m", "glue_rl", "paper", *arguments]
    first = subprocess.run(command, capture_output=True, text=True, check=True)
    assert "7 hierarchical-internal" in first.stdout
    with Results.open(tmp_path / "7") as results:
        trials = results.trials()
        assert [trial.done for trial in trials] == [3, 3]
        before = results.episodes(trials[0].spec.id)
    with (tmp_path / REPORT / "tables.csv").open(newline="", encoding="utf-8") as file:
        table = list(csv.DictReader(file))
    assert [row["level_difficulty"] for row in table] == ["0", "1"]
    assert float(table[0]["values"]) > 50  # reported by the agent, loaded from its checkpoint
    again = call(*arguments)
    assert again.stdout == first.stdout
    with Results.open(tmp_path / "7") as results:
        assert results.episodes(trials[0].spec.id) == before


def test_fewer_trials_want_another_directory(study: Path) -> None:
    with pytest.raises(ExperimentError, match="trials is 1, not 2") as caught:
        call("4", "--trials", 1, "--episodes", 200, "--out", study)
    assert "--out" in str(caught.value)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [((), "from 1 to 8"), (("--report-only", "4"), "omit the experiments"), (("9",), "'9' is not one of")],
)
def test_usage_error_names_the_remedy(arguments: tuple[str, ...], message: str) -> None:
    done = CliRunner().invoke(paper, arguments)
    assert done.exit_code == 2
    assert message in done.stderr
