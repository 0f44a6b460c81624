"""Figures of the experiments of Mohan (2010): the paper's, and learning curves of all agents together."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Final

from experiment_runner.analysis.stats import FloatArray, bootstrap_rng
from experiment_runner.report.plots import learning_curves, scatter
from experiment_runner.study.paper.experiments import ALL, EXPERIMENTS, PAPER_LEVEL, SOAR, PaperLevel
from experiment_runner.study.paper.outcomes import WINDOW, LevelResults

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_SAMPLE: Final = "sample"
_BEST: Final = "best"
_IN_CURVES: Final = (_SAMPLE, "4", "5", "6", "7", "8", _BEST)


def figures(outcomes: Sequence[LevelResults]) -> dict[str, Figure]:
    """Return the figures that can be drawn from these outcomes, by name.

    figure-2, ...        the paper's: every episode of every trial as a dot, on the paper's level
    soar-3, ...          the same for experiments on the Soar kernel, with our own agent
    figure-13-nearest    the same for experiment 8 on the level where our reward is closest to the paper's
    curves-0, curves-1   learning curves of the hierarchical agents, `best` and the sample agent, on the
                         paper's level seed at difficulty 0 and 1
    best                 every episode of `best` on the paper's level seed, by difficulty

    Raises:
        ExperimentError: matplotlib is not installed.
    """
    drawn = {}
    for experiment in EXPERIMENTS.values():
        level = PaperLevel(PAPER_LEVEL.seed, experiment.difficulties[0])
        panels = {o.agent: o.curves for o in outcomes if o.experiment is experiment and o.level == level}
        if panels and (experiment.figure is not None or experiment.group == SOAR):
            name = f"figure-{experiment.figure}" if experiment.group == ALL else experiment.name
            drawn[name] = scatter(panels, window=WINDOW, reference=_sample(outcomes, level))
    nearest = _nearest([outcome for outcome in outcomes if outcome.level.seed != PAPER_LEVEL.seed])
    if nearest is not None:
        name = f"{nearest.agent}, level seed {nearest.level.seed}"
        drawn[f"figure-{nearest.experiment.figure}-nearest"] = scatter({name: nearest.curves}, window=WINDOW)
    for difficulty in (0, 1):
        level = PaperLevel(PAPER_LEVEL.seed, difficulty)
        curves = {o.agent: o.curves for o in outcomes if o.experiment.name in _IN_CURVES and o.level == level}
        if curves:
            drawn[f"curves-{difficulty}"] = learning_curves(
                {("", name): one for name, one in curves.items()}, bootstrap_rng(), window=WINDOW
            )
    best = {
        f"difficulty {o.level.difficulty}": o.curves
        for o in outcomes
        if o.experiment.name == _BEST and o.level.seed == PAPER_LEVEL.seed
    }
    if best:
        drawn[_BEST] = scatter(best, window=WINDOW)
    return drawn


def _nearest(outcomes: Sequence[LevelResults]) -> LevelResults | None:
    """Return the outcome whose reward is closest to the published one."""
    distances = {
        abs(float(outcome.reward.value) - outcome.published.reward): outcome
        for outcome in outcomes
        if outcome.published is not None and outcome.published.reward is not None
    }
    return distances[min(distances)] if distances else None


def _sample(outcomes: Sequence[LevelResults], level: PaperLevel) -> tuple[str, FloatArray] | None:
    for outcome in outcomes:
        if outcome.experiment.name == _SAMPLE and outcome.level == level:
            return "the sample agent", outcome.curves
    return None
