"""The goals of the full study: what was found against what was required, and what is not judged."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from experiment_runner.executors.opening import open_run
from experiment_runner.store.records import EpisodeResult
from experiment_runner.study.paper.experiments import EXPERIMENTS, PaperLevel, plan_of
from experiment_runner.study.paper.report import END
from studies.goals import BEGIN, goals, verdicts
from tests.experiment_runner.study.paper.test_paper_outcomes import FloatArray, constant, learned_at, outcome


def test_verdicts_hold_what_was_found_against_what_was_required() -> None:
    given = verdicts(
        [
            outcome("sample", constant(134)),
            outcome("1", constant(20)),
            outcome("4", learned_at(500, 143.5)),
            outcome("5", learned_at(600, 143.5)),
        ]
    )
    later = "no later than that of `hierarchical-programmed`"
    assert {(v.required.split(":")[0], v.required.split(": ", 1)[1]): (v.found, v.met) for v in given} == {
        ("`sample`", "within 3 of 130.45, the original's reward"): ("134.00", False),
        ("`tiles`", "fails: less reward than the sample agent"): ("20.00 against 134.00", True),
        ("`hierarchical-programmed`", "reward of 143.5 or more"): ("143.50", True),
        ("`hierarchical`", "reward of 144 or more"): ("143.50", False),
        ("`hierarchical`", "mean curve reached by episode 1000"): ("699", True),
        ("`hierarchical`", f"mean curve reached {later}"): ("699 against 599", False),
        ("`hierarchical`", f"median trial reached {later}"): ("699 against 599", False),
    }


def test_verdict_on_spread_and_order_is_against_all_three() -> None:
    others = [
        outcome(name, learned_at(at) + np.array([[0.0], [2.0]] * 5))
        for name, at in (("4", 300), ("5", 90), ("6", 300))
    ]
    given = verdicts([*others, outcome("7", learned_at(100) + np.array([[0.0], [1.0]] * 5))])
    seven = {
        v.required.split(": ", 1)[1]: (v.found, v.met)
        for v in given
        if v.required.startswith("`hierarchical-internal`")
    }
    assert seven["mean curve reached by episode 200"] == ("199", True)
    assert seven["mean curve reached before those of 4, 5 and 6"] == ("199 against 399, 189, 399", False)
    assert seven["deviation between trials less than theirs"] == ("0.50 against 1.00, 1.00, 1.00", True)


@pytest.mark.parametrize("curves", [constant(150, trials=9), constant(150, episodes=4999)])
def test_part_of_the_study_is_not_judged(curves: FloatArray) -> None:
    assert {verdict.met for verdict in verdicts([outcome("best", curves)])} == {None}


def test_best_is_held_against_goals_at_every_difficulty() -> None:
    given = verdicts(
        [outcome("best", constant(120), level=PaperLevel(121, difficulty)) for difficulty in range(4)]
    )
    assert [verdict.met for verdict in given] == [False, True, True, True, True]


def test_the_page_has_the_table_that_is_printed(tmp_path: Path) -> None:
    plan = plan_of(EXPERIMENTS["sample"], episodes=1, trials=1)
    with open_run(tmp_path / "sample", plan) as store:
        store.record(plan.expand()[0].id, EpisodeResult(1, 130.0, 300, True, 0.01))
    page = tmp_path / "page.md"
    page.write_text(f"before\n{BEGIN}\nold\n{END}\nafter\n")
    done = CliRunner().invoke(goals, [str(tmp_path), "--docs", str(page)], catch_exceptions=False)
    assert "| `sample`: within 3 of 130.45, the original's reward | 130.00 | not judged: " in done.stdout
    assert page.read_text() == f"before\n{BEGIN}\n\n{done.stdout}\n{END}\nafter\n"
