"""Figures of episode returns as PNG and SVG: learning curves, scatter plots, comparisons.

Drawn with matplotlib (extra `plot`), whose global state is left as it was. Figures are legible at half a
page. The colors are Okabe and Ito's, which color-blind people can distinguish; lines also differ in dash.
With the same version of matplotlib, the same data give the same file, byte for byte.
"""

from __future__ import annotations

import contextlib
import math
import textwrap
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from experiment_runner.analysis.curves import over_episodes
from experiment_runner.analysis.stats import (
    FloatArray,
    estimate,
    interquartile_mean,
    mean,
    mean_of_last,
    running_mean,
)
from experiment_runner.report.tables import counted
from experiment_runner.store.output import written
from glue.errors import ExperimentError

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["comparison", "fitting_window", "learning_curves", "save", "scatter"]

_COLORS: Final = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
_DASHES: Final = ("-", "--", ":", "-.")
_STYLE: Final[dict[Any, Any]] = {
    "axes.axisbelow": True,
    "axes.grid": True,
    "axes.spines.right": False,
    "axes.spines.top": False,
    "axes.titlelocation": "left",
    "axes.titlesize": "small",
    "figure.constrained_layout.use": True,
    "figure.dpi": 200,
    "font.family": "DejaVu Sans",  # comes with matplotlib
    "font.size": 11,
    "grid.alpha": 0.3,
    "legend.frameon": False,
    "lines.linewidth": 1.8,
    "svg.hashsalt": "glue-plot",
}
_METADATA: Final[dict[str, dict[str, Any]]] = {".png": {}, ".svg": {"Date": None}}
_WIDTH: Final = 6.4  # inches, as all lengths below
_HEIGHT: Final = 4.0
_PANEL_HEIGHT: Final = 2.6
_ROW_HEIGHT: Final = 0.45
_TITLE_LETTERS: Final = 72  # across a figure
_LEGEND_LETTERS: Final = 80  # in a line of the legend; an entry takes 6 beside its name
_RETURN: Final = "episode return (reward)"


def learning_curves(
    curves: Mapping[str, FloatArray], rng: np.random.Generator, *, window: int = 100
) -> Figure:
    """Return a figure of running means over trials, each with its 95 % bootstrap band.

    Args:
        curves: (trials, episodes) by name. A single trial has no band, and a curve shorter than the window
            is left out.
        rng: for resampling.
        window: episodes in the running mean; at most a tenth of the longest curve is used.

    Raises:
        ExperimentError: matplotlib is not installed, or there is nothing to draw yet.
    """
    window = fitting_window(window, curves)
    with _style():
        figure, (axes,) = _panels(1, 1, _HEIGHT)
        for number, (name, returns) in enumerate(curves.items()):
            curve = over_episodes(returns, window, rng)
            if curve is None:
                continue  # too short yet
            value, low, high = curve.band
            color, dash = _look(number)
            axes.plot(curve.at, value, label=name, color=color, linestyle=dash)
            axes.fill_between(curve.at, low, high, color=color, alpha=0.2, linewidth=0)
        axes.set_title(
            f"running mean of {counted(window, 'episode')} over {_trials(curves.values())}, "
            "with 95 % bootstrap bands"
        )
        axes.set_xlabel("episode")
        axes.set_ylabel(_RETURN)
        axes.set_xlim(left=0)
        _legend_below(figure, axes)
    return figure


def scatter(
    curves: Mapping[str, FloatArray], *, window: int = 100, reference: tuple[str, FloatArray] | None = None
) -> Figure:
    """Return a figure with a panel for each curve: a dot for each episode of each trial, and their mean.

    Args:
        curves: (trials, episodes) by name.
        window: episodes in the running mean; at most a tenth of the longest curve is used.
        reference: name and returns, (trials, episodes), of a curve whose running mean is in every panel.

    Raises:
        ExperimentError: matplotlib is not installed, or there is nothing to draw yet.

    Source of the design: Mohan (2010), figures 2 to 13.
    """
    window = fitting_window(window, curves)
    columns = 1 if len(curves) == 1 else 2
    rows = math.ceil(len(curves) / columns)
    with _style():
        figure, panels = _panels(rows, columns, _HEIGHT if rows == 1 else rows * _PANEL_HEIGHT, len(curves))
        for number, (name, returns) in enumerate(curves.items()):
            axes = panels[number]
            episode = np.broadcast_to(np.arange(1, returns.shape[1] + 1), returns.shape)
            axes.plot(
                episode.ravel(),
                returns.ravel(),
                linestyle="none",
                marker=".",
                markersize=3,
                markeredgewidth=0,
                color=_COLORS[0],
                alpha=min(1.0, max(0.08, 2000 / returns.size)),
                rasterized=True,  # as vectors, tens of thousands of dots make an SVG too large to open
            )
            if reference is not None:
                _plot_mean(axes, reference[1], window, reference[0], "--", "0.4")
            _plot_mean(axes, returns, window, f"mean of {counted(window, 'episode')}", "-", "black")
            count = _trials([returns]).replace(" ", "\N{NO-BREAK SPACE}")
            axes.set_title(textwrap.fill(f"{name} ({count})", _TITLE_LETTERS // columns))
            axes.set_xlim(left=0)
            if number + columns >= len(curves):  # no panel below
                axes.set_xlabel("episode")
                axes.tick_params(labelbottom=True)
        figure.supylabel(_RETURN, fontsize="medium")
        # The dots in the panels are too faint for a legend.
        panels[0].plot([], [], ".", color=_COLORS[0], label="an episode")
        _legend_below(figure, panels[0])
    return figure


def comparison(
    agents: Mapping[str, Sequence[FloatArray]], rng: np.random.Generator, *, window: int = 100
) -> Figure:
    """Return a figure of the final performance of each agent, with 95 % stratified bootstrap intervals.

    Args:
        agents: the returns of each agent in each environment, (trials, episodes), by name. Environments
            have equal weight: if one has more trials than another, its last trials are left out.
        rng: for resampling.
        window: the performance is the mean return of this many last episodes of a trial.

    Raises:
        ExperimentError: matplotlib is not installed, or there is nothing to draw yet.
    """
    reached = {
        name: [np.array([mean_of_last(trial, window) for trial in returns]) for returns in strata]
        for name, strata in agents.items()
    }
    for name, strata in reached.items():
        fewest = min(map(len, strata))
        reached[name] = [trials[:fewest] for trials in strata if fewest]
    if not reached or not all(reached.values()):
        raise ExperimentError(_NOTHING)
    with _style():
        figure, (axes,) = _panels(1, 1, 1.6 + _ROW_HEIGHT * len(agents))
        for row, strata in enumerate(reached.values()):
            trials = np.concatenate(strata)
            axes.plot(
                trials, np.full(len(trials), row), "|", color="0.5", markersize=9, label=_once(row, "trial")
            )
            for statistic, name, marker, shift, color in (
                (mean, "mean", "o", -0.2, _COLORS[0]),
                (interquartile_mean, "interquartile mean", "D", 0.2, _COLORS[1]),
            ):
                value, low, high = estimate(strata, statistic, rng)
                axes.plot([low, high], [row + shift] * 2, color=color)
                axes.plot(value, row + shift, marker, color=color, markersize=4, label=_once(row, name))
        axes.set_yticks(range(len(agents)), list(agents))
        axes.set_ylim(len(agents) - 0.5, -0.5)
        axes.grid(visible=False, axis="y")
        axes.set_title(f"last {counted(window, 'episode')} of each trial, with 95 % bootstrap intervals")
        axes.set_xlabel(_RETURN)
        _legend_below(figure, axes)
    return figure


def save(figure: Figure, path: Path) -> None:
    """Write a figure as PNG or SVG, depending on the suffix of the file name.

    Raises:
        ExperimentError: the suffix is neither .png nor .svg, or the file cannot be written.
    """
    if path.suffix not in _METADATA:
        raise ExperimentError(f"a figure is saved as .png or .svg, not as {path.name}")
    with _style(), written(path) as partial:
        figure.savefig(partial, format=path.suffix[1:], metadata=_METADATA[path.suffix])


_NOTHING: Final = "there is nothing to draw yet: no episode is finished"


@contextlib.contextmanager
def _style() -> Iterator[None]:
    try:
        import matplotlib
    except ImportError:
        raise ExperimentError("figures need matplotlib: pip install 'glue-rl[plot]'") from None
    with matplotlib.rc_context():
        matplotlib.rcdefaults()  # independent of the user's own style
        matplotlib.rcParams.update(_STYLE)
        yield


def _panels(rows: int, columns: int, height: float, used: int = 1) -> tuple[Figure, list[Axes]]:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(_WIDTH, height))
    grid = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
    panels = list(grid.flat)
    for axes in panels[used:]:
        axes.remove()
    return figure, panels[:used]


def _plot_mean(axes: Axes, returns: FloatArray, window: int, name: str, dash: str, color: str) -> None:
    means = mean(running_mean(returns, window))
    axes.plot(np.arange(len(means)) + window, means, dash, color=color, linewidth=1.2, label=name)


def _legend_below(figure: Figure, axes: Axes) -> None:
    handles, names = axes.get_legend_handles_labels()
    columns = max(1, min(len(names), _LEGEND_LETTERS // (max(map(len, names)) + 6)))
    figure.legend(handles, names, loc="outside lower center", ncols=columns, fontsize="small")


def fitting_window(window: int, curves: Mapping[str, FloatArray]) -> int:
    """Return the window that is used for curves: a tenth of the longest if that is less.

    Raises:
        ExperimentError: there is nothing to plot yet.
    """
    longest = max((returns.shape[1] for returns in curves.values()), default=0)
    if not longest:
        raise ExperimentError(_NOTHING)
    return min(window, max(1, longest // 10))


def _look(number: int) -> tuple[str, str]:
    return _COLORS[number % len(_COLORS)], _DASHES[number % len(_DASHES)]


def _trials(curves: Iterable[FloatArray]) -> str:
    counts = sorted({len(returns) for returns in curves})
    return counted(counts[0], "trial") if len(counts) == 1 else f"{counts[0]} to {counts[-1]} trials"


def _once(row: int, name: str) -> str | None:
    return name if row == 0 else None
