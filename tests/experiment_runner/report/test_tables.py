"""Tables on terminals of any width, and the summary at the end of `glue-experiment`."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from experiment_runner.analysis.settings import collect
from experiment_runner.executors.opening import open_run
from experiment_runner.plan.plan import Plan, RoleSweep
from experiment_runner.report.markup import LATEX, MARKDOWN, paper_table
from experiment_runner.report.overview import as_text
from experiment_runner.report.tables import format_table, summarize, tabulate
from experiment_runner.store.records import EpisodeResult
from experiment_runner.store.store import Store
from glue.errors import ExperimentError
from tests.memory import taking_less_than

PLAN = Plan(episodes=20_000, trials=3, environments=(RoleSweep("mines"),), agents=(RoleSweep("sarsa"),))
FIRST, SECOND, THIRD = (spec.id for spec in PLAN.expand())


@pytest.fixture
def store(tmp_path: Path) -> Iterator[Store]:
    with open_run(tmp_path / "run", PLAN) as store:
        yield store


def record(store: Store, trial_id: str, *returns: float) -> None:
    for episode, value in enumerate(returns, store.done(trial_id) + 1):
        store.record(trial_id, EpisodeResult(episode, value, episode, episode % 3 > 0, 0.5))


HEADER = ("run", "episodes", "reason")
ROWS = (
    ("runs/first", "200/200", ""),
    ("runs/b", "7/5000", "sarsa/mines/0: the agent raised an error in step 7"),
)
SPACIOUS = """\
run         episodes  reason
runs/first   200/200
runs/b        7/5000  sarsa/mines/0: the agent raised an error in step 7"""
WRAPPED = """\
run         episodes  reason
runs/first   200/200
runs/b        7/5000  sarsa/mines/0: the agent raised
                      an error in step 7"""
PARAGRAPHS = """\
runs/first
  episodes  200/200

runs/b
  episodes  7/5000
  reason    sarsa/mines/0: the agent
            raised an error in step 7"""


@pytest.mark.parametrize(
    ("width", "table"), [(None, SPACIOUS), (72, SPACIOUS), (55, WRAPPED), (40, PARAGRAPHS)]
)
def test_narrow_table_wraps_its_last_column_and_then_becomes_paragraphs(
    width: int | None, table: str
) -> None:
    assert format_table(HEADER, ROWS, width=width, prose=True) == table


def test_narrow_table_of_numbers_becomes_paragraphs() -> None:
    paragraphs = format_table(
        ("agent", "steps", "mean"), [("a", "1,000", "-2.50"), ("b", "7", "1.00")], width=14
    )
    assert paragraphs == "a\n  steps  1,000\n  mean   -2.50\n\nb\n  steps  7\n  mean   1.00"


def test_long_words_are_never_broken_nor_rows_merged() -> None:
    table = format_table(("run", "out"), [("x" * 30, "y" * 30)], width=20)
    assert table.split() == ["x" * 30, "out", "y" * 30]


def test_control_characters_do_not_reach_the_terminal() -> None:
    assert format_table(("a", "b"), [("x\x1b[2J\ny", "1\r2")]) == "a          b\nx?[2J y  1 2"


def test_table_and_summary_are_of_all_episodes_and_of_the_last(store: Store) -> None:
    returns = np.random.default_rng(1).normal(0, 10, 130)
    record(store, FIRST, *returns.tolist())
    record(store, SECOND, 1.0, 2.0, 4.5)
    store.record_void(SECOND, 4, "the agent left")
    store.record_failure(SECOND, "the agent left for good")
    header, first, second, third, _, failure, last = tabulate(store, 7.0).splitlines()
    assert " ".join(header.split()) == "trial episodes steps mean return mean of last 100 cut off void"
    means = f"{returns.mean():.2f}", f"{returns[-100:].mean():.2f}"
    assert first.split() == [FIRST, "130/20000", "8,515", *means, "43", "0"]
    assert second.split() == [SECOND, "3/20000", "6", "2.50", "2.50", "1", "1"]
    assert third.split() == [THIRD, "0/20000", "0", "-", "-", "0", "0"]
    assert failure == f"failed: {SECOND}: the agent left for good"
    assert last == f"7.0 s; results in {store.directory}"
    assert summarize(store, 7.0) == {
        "summary": True,
        "episodes": 133,
        "steps": 8521,
        "mean_return": pytest.approx((returns.sum() + 7.5) / 133),
        "mean_last_100": pytest.approx((returns[-100:].sum() + 7.5) / 103),
        "cut_off": 44,
        "voids": 1,
        "failed_trials": 1,
        "seconds": 7.0,
        "out": str(store.directory),
    }


def test_paper_table_has_agents_in_rows_and_environments_in_columns(tmp_path: Path) -> None:
    plan = Plan(
        episodes=2,
        trials=2,
        environments=(RoleSweep("mines"), RoleSweep("a_b")),
        agents=(RoleSweep("sarsa", {"epsilon": (0.1, 0.2)}),),
    )
    with open_run(tmp_path / "run", plan) as store:
        for number, spec in enumerate(plan.expand()):
            record(store, spec.id, -float(number), -float(number))
        settings = collect([store])
        store.rewind(spec.id, 1)
        store.record_failure(spec.id, "a mistake")
        assert "1 failed trial left out." in paper_table(collect([store]), "episodes", MARKDOWN)
        latex, markdown = (paper_table(settings, "episodes", markup) for markup in (LATEX, MARKDOWN))
    few = "(!) of fewer than 5 trials: the interval may well miss the mean."
    mean = "Mean over 2 trials of the mean return of the last 100 episodes, with its 95 % bootstrap interval."
    assert latex.splitlines() == [
        f"% {mean}",
        f"% {few}",
        r"\begin{tabular}{lll}",
        r"\toprule",
        r"agent & mines & a\_b \\",
        r"\midrule",
        r"sarsa epsilon=0.1 & $-0.50$ [$-1.00$, $0.00$] (!) & $-2.50$ [$-3.00$, $-2.00$] (!) \\",
        r"sarsa epsilon=0.2 & $-4.50$ [$-5.00$, $-4.00$] (!) & $-6.50$ [$-7.00$, $-6.00$] (!) \\",
        r"\bottomrule",
        r"\end{tabular}",
    ]
    assert markdown.splitlines()[0] == r"| agent | mines | a\_b |"
    assert markdown.splitlines()[2].startswith("| sarsa epsilon=0.1 | \N{MINUS SIGN}0.50 [")
    assert markdown.splitlines()[-1] == f"{mean} {few}"
    assert (LATEX.text("a|&"), MARKDOWN.text("a|&")) == (r"a|\&", r"a\|&")
    assert MARKDOWN.text("![a](b)") == r"!\[a\](b)"
    with pytest.raises(ExperimentError, match="nothing to show"):
        paper_table([], "episodes", LATEX)


def test_what_all_trials_of_a_player_have_in_common_is_one_line(store: Store) -> None:
    for trial_id in (FIRST, SECOND, THIRD):
        store.record_event("unsaved", "no checkpoints: no agent_save", trial_id)
        store.record_event("lost", "its worker was lost", trial_id)
    shown = as_text([store]).splitlines()
    assert sum(line.startswith("lost: ") for line in shown) == 3
    (line,) = (line for line in shown if line.startswith("unsaved"))
    assert line == f"unsaved: {FIRST} and 2 other trials: no checkpoints: no agent_save"


def test_summary_of_nothing_has_no_mean(store: Store) -> None:
    summary = summarize(store, 0.0)
    assert (summary["episodes"], summary["mean_return"], summary["mean_last_100"]) == (0, None, None)


@pytest.mark.parametrize(
    ("values", "mean", "shown"),
    [
        ((1.0, math.nan), math.nan, "nan"),
        ((1.0, math.inf), math.inf, "inf"),
        ((-math.inf, math.inf), math.nan, "nan"),
        ((9e14,), 9e14, "900000000000000.00"),
        ((-1e300, -1e300), -1e300, "-1e+300"),
    ],
)
def test_unusual_returns_show_in_the_means(
    store: Store, values: tuple[float, ...], mean: float, shown: str
) -> None:
    record(store, FIRST, *values)
    assert summarize(store, 0.0)["mean_return"] == pytest.approx(mean, nan_ok=True)
    assert tabulate(store, 0.0).splitlines()[1].split()[3] == shown


def test_memory_does_not_grow_with_the_episodes(store: Store) -> None:
    record(store, FIRST, *[1.0] * 20_000)
    with taking_less_than(200_000):
        tabulate(store, 0.0)
        summarize(store, 0.0)


def test_no_word_of_a_run_is_broken_on_a_narrow_terminal(tmp_path: Path) -> None:
    why = "no hub has answered at tcp://127.0.0.1:4097 for 10 s: start one, or check the address"
    with open_run(tmp_path / "run", PLAN) as store:
        store.record_failure(FIRST, why)
        texts = [(as_text([store]), as_text([store], 30)), (tabulate(store, 1), tabulate(store, 1, 30))]
    for wide, narrow in texts:
        assert why in wide
        assert why.split() in [
            narrow.split()[at : at + len(why.split())] for at in range(len(narrow.split()))
        ]
        longest = [line for line in narrow.splitlines() if len(line) > 30]
        assert all(len(line.split()) == 1 for line in longest), longest
