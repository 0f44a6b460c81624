"""Tables of a benchmark: goal rate, interquartile mean of the returns, intervals, and the generalisation gap.

As in rliable: the interquartile mean is the mean of the middle half of the scores of all trials and levels,
and intervals are 95 % percentile bootstrap intervals that resample trials within each level. With one trial
there is nothing to resample within a level; then the levels themselves are resampled.

Source: Agarwal et al. (2021), Deep reinforcement learning at the edge of the statistical precipice.
"""

from __future__ import annotations

from collections.abc import Sequence, Set
from typing import Any, Final

import numpy as np

from experiment_runner.analysis.stats import (
    Estimate,
    FloatArray,
    Statistic,
    bootstrap_rng,
    interquartile_mean,
    mean,
    with_interval,
)
from experiment_runner.report.tables import format_table, markdown_table, terminal_width
from glue.errors import ConfigError

_RESAMPLES: Final = 1000
_SCORES: Final = ("goal", "episode_return")
_COLUMNS: Final = ("training", "unseen", "gap")
_HEAD: Final = ("agent", "trials", *(f"{what}, {name}" for what in ("goal", "return") for name in _COLUMNS))
_HEAD_BY_DIFFICULTY: Final = ("agent", "set", "difficulty", "levels", "trials", "goal", "return", "steps")

Document = dict[str, Any]
"""The scores of a benchmark, see `experiment_runner.study.generalisation.benchmark.document`."""


def summarise(document: Document) -> list[Estimate]:
    """Return the goal rate and the mean return, each on training levels, on unseen ones, and the gap."""
    trials = document["trials"]
    train, test = (
        [_scores([trial[levels] for trial in trials], what) for what in _SCORES]
        for levels in ("train", "test")
    )
    goals, returns = zip(train, test, strict=True)
    return [*_compare(*goals, mean), *_compare(*returns, interquartile_mean)]


def table(documents: Sequence[Document], solvable: Set[int] = frozenset(), *, plain: bool = False) -> str:
    """Return a table: a row for each benchmark or, with scored sets, for each difficulty.

    Args:
        documents: the benchmarks.
        solvable: numbers of levels; the share of these that were solved is a column of a table by difficulty.
        plain: for a terminal; otherwise in Markdown.

    Raises:
        ConfigError: some have scores for each difficulty, and others do not; or fields are missing, or of
            another type.
    """
    kinds = {bool(document.get("sets")) for document in documents}
    if len(kinds) > 1:
        raise ConfigError(
            "scores of each difficulty and scores of two sets have different tables: show them apart"
        )
    try:
        if True in kinds:
            messages = list(documents[0]["questions"])
            rows = [row for document in documents for row in _by_difficulty(document, messages, solvable)]
            solved = ["goal, if solvable"] if solvable else []
            head = [*_HEAD_BY_DIFFICULTY, "ms per step", *messages, *solved]
        else:
            head, rows = list(_HEAD), list(map(_gap_row, documents))
    except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError) as error:
        raise ConfigError(f"these are not scores of glue-generalise: {error!r:.200}") from None
    if plain:
        return format_table(head, rows, width=terminal_width())
    return markdown_table(head, rows, texts=2 if True in kinds else 1)


def _gap_row(document: Document) -> list[str]:
    cells = map(_text, summarise(document), (3, 3, 3, 1, 1, 1))
    return [document["name"], str(len(document["trials"])), *cells]


def _by_difficulty(document: Document, messages: Sequence[str], solvable: Set[int]) -> list[list[str]]:
    """Return a row for each set and difficulty, and for all difficulties of a set with several."""
    rows = []
    for name in document["sets"]:
        trials = [trial[name] for trial in document["trials"]]
        difficulties = sorted({score["difficulty"] for score in trials[0]})
        for difficulty in [*difficulties, *(["all"] if len(difficulties) > 1 else [])]:
            chosen = [
                [score for score in trial if difficulty in (score["difficulty"], "all")] for trial in trials
            ]
            scores = [score for trial in chosen for score in trial]
            steps = sum(score["steps"] for score in scores)
            goals, returns = (_scores(chosen, what) for what in _SCORES)
            rows.append(
                [
                    *(document["name"], name, str(difficulty), str(len(chosen[0])), str(len(chosen))),
                    estimated(goals, mean, 3),
                    estimated(returns, interquartile_mean, 1),
                    f"{steps / len(scores):.1f}",
                    f"{1000 * sum(score['seconds'] for score in scores) / max(steps, 1):.3f}",
                    *(_mean_answer(scores, message) for message in messages),
                    *([_share_of(scores, solvable)] if solvable else []),
                ]
            )
    return rows


def _share_of(scores: Sequence[dict[str, Any]], solvable: Set[int]) -> str:
    """Return the share of the solvable levels that were solved; empty without any."""
    goals = [score["goal"] for score in scores if score["level"] in solvable]
    return f"{np.mean(goals):.3f}" if goals else ""


def _mean_answer(scores: Sequence[dict[str, Any]], message: str) -> str:
    """Return the mean of the answers to a message; empty unless all are numbers."""
    try:
        return f"{np.mean([float(score['answers'][message]) for score in scores]):.6g}"
    except ValueError:
        return ""


def _scores(trials: Sequence[Sequence[dict[str, Any]]], what: str) -> FloatArray:
    """Return one kind of score, shape (levels, trials)."""
    return np.array([[score[what] for score in trial] for trial in trials], np.float64).T


def _compare(
    train: FloatArray, test: FloatArray, statistic: Statistic
) -> tuple[Estimate, Estimate, Estimate]:
    rng = bootstrap_rng()
    values = [float(statistic(scores.ravel())) for scores in (train, test)]
    samples = [_samples(scores, statistic, rng) for scores in (train, test)]
    return (
        with_interval(values[0], samples[0]),
        with_interval(values[1], samples[1]),
        with_interval(values[0] - values[1], samples[0] - samples[1]),
    )


def estimated(scores: FloatArray, statistic: Statistic, digits: int) -> str:
    """Return a statistic of scores, shape (levels, trials), with its interval."""
    samples = _samples(scores, statistic, bootstrap_rng())
    return _text(with_interval(float(statistic(scores.ravel())), samples), digits)


def _samples(scores: FloatArray, statistic: Statistic, rng: np.random.Generator) -> FloatArray:
    """Return the statistic of resampled scores, shape (resamples,)."""
    return np.array([statistic(_resampled(scores, rng).ravel()) for _ in range(_RESAMPLES)])


def _resampled(scores: FloatArray, rng: np.random.Generator) -> FloatArray:
    levels, trials = scores.shape
    if trials == 1:
        drawn: FloatArray = scores[rng.integers(levels, size=levels)]
        return drawn
    resampled: FloatArray = np.take_along_axis(scores, rng.integers(trials, size=scores.shape), axis=1)
    return resampled


def _text(estimate: Estimate, digits: int) -> str:
    value, low, high = (f"{number:.{digits}f}" for number in estimate)
    return f"{value} ({low} to {high})"
