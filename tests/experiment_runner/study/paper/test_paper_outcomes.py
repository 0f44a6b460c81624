from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

from experiment_runner.executors.opening import open_run
from experiment_runner.plan.plan import Plan, RoleSweep
from experiment_runner.store.records import EpisodeResult
from experiment_runner.study.paper.experiments import EXPERIMENTS, PAPER_LEVEL, PaperLevel, plan_of
from experiment_runner.study.paper.outcomes import LevelResults, load
from experiment_runner.study.paper.report import figures
from glue.errors import ExperimentError

FloatArray = npt.NDArray[np.float64]


def outcome(
    name: str, curves: FloatArray | list[list[float]], agent: int = 0, level: PaperLevel = PAPER_LEVEL
) -> LevelResults:
    experiment = EXPERIMENTS[name]
    returns = np.asarray(curves, np.float64)
    return LevelResults(experiment, experiment.agents[agent].label, level, len(returns), returns, (), 0, 0.0)


def constant(reward: float, trials: int = 10, episodes: int = 5000) -> FloatArray:
    return np.full((trials, episodes), reward)


def learned_at(episode: int, reward: float = 140.0, trials: int = 10, episodes: int = 5000) -> FloatArray:
    """Return trials with a return of 0 up to an episode, and a constant return after it."""
    curves = constant(reward, trials, episodes)
    curves[:, :episode] = 0.0
    return curves


def test_reward_is_the_mean_of_the_last_hundred_and_its_interval_spans_the_trials() -> None:
    found = outcome("4", [[0.0] * 200 + [140.0] * 100, [0.0] * 200 + [150.0] * 100])
    assert found.rewards.tolist() == [140.0, 150.0]
    assert found.reward.value == 145.0
    assert 140.0 <= found.reward.low < 145.0 < found.reward.high <= 150.0


def test_relapse_delays_settling_but_not_reaching() -> None:
    curves = learned_at(100, trials=2, episodes=2000)
    assert (outcome("4", curves).reached, outcome("4", curves).settled) == (199, 199)
    curves[0, 1000:1010] = 0.0  # 0 is 140 below, so ten episodes of one of two trials lower the mean by 7
    relapsed = outcome("4", curves)
    assert (relapsed.reached, relapsed.settled) == (199, 1108)
    assert (relapsed.trials_reached, relapsed.trials_settled) == ([199, 199], [199, 1109])


def test_curve_that_ends_lower_reached_its_end_at_once() -> None:
    assert outcome("4", np.linspace(150, 100, 400)[None, :]).reached == 100


def test_fewer_episodes_than_the_window_reach_nothing() -> None:
    found = outcome("4", constant(140, episodes=99))
    assert (found.reached, found.settled, found.trials_reached, found.trials_settled) == (None, None, [], [])
    assert found.reward.value == 140


def test_trial_finishes_that_reaches_the_goal_in_half_of_its_last_episodes() -> None:
    curves = np.full((3, 200), 45.0)  # death, with every coin of the level
    curves[0, 150:] = 90.0  # the goal, at the last possible step, without a coin
    curves[1, 151:] = 150.0
    found = outcome("4", curves)
    assert found.finishing.tolist() == [0.5, 0.49, 0.0]
    assert found.trials_finishing == 1


def test_published_numbers_are_of_the_papers_agent_and_difficulty_alone() -> None:
    published = outcome("4", constant(1)).published
    assert published is not None
    assert published.reward == 146.91
    assert outcome("1", constant(1)).published is not None
    assert outcome("1", constant(1), agent=1).published is None
    assert outcome("best", constant(1)).published is None


def test_load_returns_what_is_there_in_the_order_of_the_experiments(tmp_path: Path) -> None:
    for name in ("4", "sample"):
        plan = plan_of(EXPERIMENTS[name], episodes=2, trials=2)
        with open_run(tmp_path / name, plan) as store:
            for number, spec in enumerate(plan.expand()[:3]):
                for episode in (1, 2):
                    store.record(spec.id, EpisodeResult(episode, float(number), 10, True, 0.5))
    sample, sample_harder, four, _ = load(tmp_path)
    assert (sample.agent, sample.level, sample.planned) == ("sample", PAPER_LEVEL, 2)
    assert sample.curves.tolist() == [[0.0, 0.0], [1.0, 1.0]]
    assert (sample.steps, sample.seconds, sample.values) == (40, 2.0, ())
    assert (sample_harder.level, sample_harder.curves.tolist()) == (PaperLevel(121, 1), [[2.0, 2.0]])
    assert four.agent == "hierarchical-programmed"


def test_load_refuses_the_run_of_something_else(tmp_path: Path) -> None:
    with open_run(tmp_path / "4", Plan(episodes=1, environments=(RoleSweep("mines"),))):
        pass
    with pytest.raises(ExperimentError, match="not a run of experiment 4"):
        load(tmp_path)


def test_figures_hold_the_levels_and_agents_they_are_for() -> None:
    drawn = figures(
        [
            outcome("sample", constant(130)),
            outcome("1", constant(20)),
            outcome("1", constant(140), agent=1),
            outcome("7", constant(145)),
            outcome("7", constant(-5), level=PaperLevel(121, 1)),
            outcome("8", constant(2), level=PaperLevel(121, 1)),
            outcome("8", constant(-5), level=PaperLevel(4, 1)),
            outcome("8", constant(69), level=PaperLevel(6, 1)),
            outcome("best", constant(150)),
            outcome("best", constant(90), level=PaperLevel(121, 3)),
            outcome("best", constant(80), level=PaperLevel(5, 3)),
        ]
    )
    titles = {name: [axes.get_title(loc="left") for axes in figure.axes] for name, figure in drawn.items()}
    assert [title.replace("\N{NO-BREAK SPACE}", " ") for title in titles["figure-2"]] == [
        "tiles (10 trials)",
        "tiles-textbook (10 trials)",
    ]
    assert len(titles["figure-11"]) == 1
    (nearest,) = titles["figure-13-nearest"]
    assert nearest.startswith("objects-coarse, level seed 6 (")
    assert [title.split(" (")[0] for title in titles["best"]] == ["difficulty 0", "difficulty 3"]
    curves = [text.get_text() for text in drawn["curves-0"].legends[0].get_texts()]
    assert curves == ["sample", "hierarchical-internal", "best"]
    assert sorted(drawn) == [
        *("best", "curves-0", "curves-1", "figure-11", "figure-13", "figure-13-nearest", "figure-2")
    ]
