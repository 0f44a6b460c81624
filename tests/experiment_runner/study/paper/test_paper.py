from __future__ import annotations

from collections import Counter

import pytest

from experiment_runner.plan.plan import RoleSpec, TrialSpec, check_options
from experiment_runner.study.paper.experiments import EXPERIMENTS, PAPER_LEVEL, PaperLevel, level_of, plan_of
from glue.errors import ExperimentError
from glue.plugins.loading import find
from glue.wire.messages import Role


def level(spec: TrialSpec) -> PaperLevel:
    assert spec.environment is not None
    return level_of(spec.environment)


@pytest.mark.parametrize("name", list(EXPERIMENTS))
def test_every_experiment_is_a_plan_that_its_players_accept(name: str) -> None:
    plan = plan_of(EXPERIMENTS[name])
    assert check_options(plan, lambda role, kind: find(Role(role), kind)) == plan
    assert (plan.episodes, plan.trials) == (
        1000 if name.startswith("soar") else 5000,
        EXPERIMENTS[name].trials,
    )


@pytest.mark.parametrize(
    ("name", "levels"),
    [
        ("1", [PAPER_LEVEL]),
        ("7", [PAPER_LEVEL, PaperLevel(121, 1)]),
        ("8", [PaperLevel(seed, 1) for seed in (121, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10)]),
    ],
)
def test_levels_are_those_of_the_paper_and_come_first(name: str, levels: list[PaperLevel]) -> None:
    played = Counter(level(spec) for spec in plan_of(EXPERIMENTS[name]).expand())
    assert list(played) == levels
    assert set(played.values()) == {10 * len(EXPERIMENTS[name].agents)}


def test_only_the_textbook_agent_learns_the_terminal_reward() -> None:
    lost, textbook = EXPERIMENTS["1"].agents
    assert (lost.label, dict(lost.options)) == ("tiles", {})
    assert (textbook.label, dict(textbook.options)) == ("tiles-textbook", {"terminal_update": True})


def test_every_figure_of_the_paper_that_shows_an_agent_is_there() -> None:
    assert [e.figure for e in EXPERIMENTS.values() if e.figure] == [2, 3, 5, 8, 9, 10, 11, 13]


def test_level_of_another_plan_is_refused() -> None:
    with pytest.raises(ExperimentError, match="mines does not set the level"):
        level_of(RoleSpec("mines"))
