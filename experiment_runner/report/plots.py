"""Figures of a measure of the episodes as PNG, SVG and PDF: learning curves, scatter plots, comparisons.

Drawn with matplotlib (extra `plot`), whose global state is left unchanged. Figures are legible at half a
page. The colors are Okabe and Ito's, which color-blind people can distinguish; lines also differ in dash.
With the same version of matplotlib, the same data give the same file, byte for byte.
"""

from __future__ import annotations

import contextlib
import math
import textwrap
from collections.abc import Iterable, Iterator, Mapping, Sequence, Sized
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Literal

import numpy as np

from experiment_runner.analysis import stats
from experiment_runner.analysis.curves import Curve, StepTotals, of_metric, over_episodes, over_steps
from experiment_runner.analysis.stats import profile, tolerance_interval
from experiment_runner.report.overview import FEW
from experiment_runner.report.tables import counted
from experiment_runner.store.run_data import written
from glue.errors import ExperimentError
from glue.installed import needing

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

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
_METADATA: Final[dict[str, dict[str, Any]]] = {
    ".png": {},
    ".svg": {"Date": None},
    ".pdf": {"CreationDate": None},
}
_WIDTH: Final = 6.4  # inches, as all lengths below
_HEIGHT: Final = 4.0
_PANEL_HEIGHT: Final = 2.6
_MARGIN: Final = 1.2  # for the title, the labels and the legend
_ROW_HEIGHT: Final = 0.45
_NAME_LETTERS: Final = 28  # of an agent, in a line
_TITLE_LETTERS: Final = 72  # across a figure
_LEGEND_LETTERS: Final = 80  # in a line of the legend; an entry takes 6 plus its name
_TOLERANCE: Final = "bands for 90 % of the trials (tolerance intervals, 95 %)"
_GREATEST: Final = 1e300  # value that Matplotlib can draw
_RETURN: Final = "episode return (reward)"


Key = tuple[str, str]
"""A curve: its environment, which has a panel, and its name there. A single environment may have no name."""


@dataclass(frozen=True, slots=True)
class Layout:
    """Settings of a figure.

    Args:
        title: text above it; None for a description of what is drawn.
        size: width and height in inches; None for 6.4 and the height that the panels need.
        columns: number of panels side by side; 0 for at most two.
        label: of the axis of values.
        tolerance: whether the bands of curves are tolerance intervals of single trials.
    """

    title: str | None = None
    size: tuple[float, float] | None = None
    columns: int = 0
    label: str = _RETURN
    tolerance: bool = False


_PLAIN: Final = Layout()


def learning_curves(
    curves: Mapping[Key, stats.FloatArray], *, window: int = 100, layout: Layout = _PLAIN
) -> Figure:
    """Return a figure of running means over trials, each with its 95 % bootstrap band.

    Args:
        curves: (trials, episodes) of each. A single trial has no band, and a curve shorter than the window
            is left out.
        window: episodes in the running mean; at most a tenth of the longest curve is used.
        layout: of the figure.

    Raises:
        ExperimentError: matplotlib is not installed, or there is nothing to draw yet.
    """
    window = fitting_window(window, (values.shape[1] for values in curves.values()))
    if not any(np.isfinite(values).any() for values in curves.values()):
        raise ExperimentError(f"there is nothing to draw: no episode has a value of {layout.label}")
    rng = stats.bootstrap_rng()
    found = {key: over_episodes(values, window, rng) for key, values in curves.items()}
    return _curves(found, window, "episode", layout)


def step_curves(
    totals: Mapping[Key, Sequence[StepTotals]], *, window: int = 0, layout: Layout = _PLAIN
) -> Figure:
    """Return a figure like that of `learning_curves`, over steps.

    Args:
        totals: of the trials of each. A curve with a trial shorter than the window is left out.
        window: steps in the running mean; at most a tenth of the longest trial is used. 0 for a fiftieth.
        layout: of the figure.

    Raises:
        ExperimentError: matplotlib is not installed, or there is nothing to draw yet.
    """
    window = step_window(window, totals.values())
    rng = stats.bootstrap_rng()
    found = {key: over_steps(trials, window, rng) for key, trials in totals.items()}
    return _curves(found, window, "step", layout)


def metric_curves(
    readings: Mapping[Key, Sequence[tuple[stats.FloatArray, stats.FloatArray]]], layout: Layout
) -> Figure:
    """Return a figure of a metric over steps: the mean over trials, with bands as in `learning_curves`.

    Args:
        readings: steps and values of the trials of each.
        layout: of the figure; its label is the name of the metric.

    Raises:
        ExperimentError: matplotlib is not installed, or there is nothing to draw yet.
    """
    rng = stats.bootstrap_rng()
    found = {key: of_metric(trials, rng) for key, trials in readings.items()}
    if not any(found.values()):
        raise ExperimentError(_NOTHING)
    return _curves(found, 0, "step", layout)


def step_window(window: int, totals: Iterable[Sequence[StepTotals]]) -> int:
    """Return the window, in steps, for curves over steps; see `step_curves`.

    Raises:
        ExperimentError: there is nothing to plot yet.
    """
    lengths = [int(trial.steps[-1]) for trials in totals for trial in trials]
    return fitting_window(window or max(lengths, default=0) // 50, lengths)


def _curves(curves: Mapping[Key, Curve | None], window: int, unit: str, layout: Layout) -> Figure:
    drawn = {key: curve for key, curve in curves.items() if curve is not None}  # others are too short yet
    with _style():
        figure, axes_of = _environments(drawn, layout, unit, layout.label)
        names = list(dict.fromkeys(name for _, name in curves))
        for (environment, name), curve in drawn.items():
            value, low, high = curve.band
            if layout.tolerance:
                low, high = np.array([tolerance_interval(values) for values in curve.means.T]).T
            color, dash = _look(names.index(name))
            axes = axes_of[environment]
            axes.plot(curve.at, value, label=_marked(name, curve.means), color=color, linestyle=dash)
            axes.fill_between(curve.at, low, high, color=color, alpha=0.2, linewidth=0)
        means = f"running mean of {counted(window, unit)}" if window else "mean"
        bands = _TOLERANCE if layout.tolerance else "95 % bootstrap bands"
        trials = [curve.means for curve in drawn.values()]
        _title(figure, f"{means} over {_trials(trials)}, with {bands}", trials, layout)
        for axes in axes_of.values():
            axes.set_xlim(left=0)
        _legend_below(figure, axes_of.values())
    return figure


def scatter(
    curves: Mapping[str, stats.FloatArray],
    *,
    window: int = 100,
    reference: tuple[str, stats.FloatArray] | None = None,
    layout: Layout = _PLAIN,
) -> Figure:
    """Return a figure with a panel for each curve: a dot for each episode of each trial, and their mean.

    Args:
        curves: (trials, episodes) by name.
        window: episodes in the running mean; at most a tenth of the longest curve is used.
        reference: name and values, (trials, episodes), of a curve whose running mean is in every panel.
        layout: of the figure, which has no title of its own.

    Raises:
        ExperimentError: matplotlib is not installed, or there is nothing to draw yet.

    Source of the design: Mohan (2010), figures 2 to 13.
    """
    window = fitting_window(window, (values.shape[1] for values in curves.values()))
    with _style():
        figure, panels, columns = _grid(len(curves), layout, "all")
        if layout.title:
            _title(figure, "", [], layout)
        for number, (name, returns) in enumerate(curves.items()):
            axes = panels[number]
            episode = np.broadcast_to(np.arange(1, returns.shape[1] + 1), returns.shape)
            axes.plot(
                episode.ravel(),
                np.where(np.abs(returns) < _GREATEST, returns, np.nan).ravel(),
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
            axes.set_title(textwrap.fill(f"{_literal(name)} ({count})", _TITLE_LETTERS // columns))
            axes.set_xlim(left=0)
            if number + columns >= len(curves):  # no panel below
                axes.set_xlabel("episode")
                axes.tick_params(labelbottom=True)
        figure.supylabel(_literal(layout.label), fontsize="medium")
        # The dots in the panels are too faint for a legend.
        panels[0].plot([], [], ".", color=_COLORS[0], label="an episode")
        _legend_below(figure, panels[:1])
    return figure


def comparison(
    environments: Mapping[str, Mapping[str, stats.FloatArray]], *, final: str, layout: Layout = _PLAIN
) -> Figure:
    """Return a figure of the final performance of each agent, with 95 % bootstrap intervals.

    Args:
        environments: the performance of each agent's trials, (trials,), by environment and agent. Each
            environment has a panel: values of different tasks have no common mean.
        final: the part of a trial over which its performance was measured, as in `last 100 episodes`.
        layout: of the figure.

    Raises:
        ExperimentError: matplotlib is not installed, or there is nothing to draw yet.
    """
    if not any(values.size for agents in environments.values() for values in agents.values()):
        raise ExperimentError(_NOTHING)
    rng = stats.bootstrap_rng()
    rows = max(map(len, environments.values()))
    with _style():
        figure, panels, _ = _grid(len(environments), layout, "none", 0.4 + _ROW_HEIGHT * rows, 1)
        for axes, (environment, agents) in zip(panels, environments.items(), strict=True):
            for row, values in enumerate(agents.values()):
                _plot_performance(axes, row, values, rng)
            axes.set_yticks(
                range(len(agents)),
                [textwrap.fill(_marked(name, values), _NAME_LETTERS) for name, values in agents.items()],
            )
            axes.set_ylim(len(agents) - 0.5, -0.5)
            axes.grid(visible=False, axis="y")
            if environment:
                axes.set_title(textwrap.fill(_literal(environment), _TITLE_LETTERS))
        panels[-1].set_xlabel(_literal(layout.label))
        curves = [values for agents in environments.values() for values in agents.values()]
        _title(figure, f"{final} of each trial, with 95 % bootstrap intervals", curves, layout)
        _legend_below(figure, panels[:1])
    return figure


def profiles(reached: Mapping[Key, stats.FloatArray], *, layout: Layout = _PLAIN) -> Figure:
    """Return a figure of performance profiles: the share of trials above each value.

    Args:
        reached: performance of the trials of each, (trials,).
        layout: of the figure.

    Raises:
        ExperimentError: matplotlib is not installed, or there is nothing to draw yet.
    """
    if not any(values.size for values in reached.values()):
        raise ExperimentError(_NOTHING)
    with _style():
        figure, axes_of = _environments(reached, layout, layout.label, "share of trials above")
        names = list(dict.fromkeys(name for _, name in reached))
        for environment, axes in axes_of.items():
            here = {name: values for (where, name), values in reached.items() if where == environment}
            known = np.concatenate(list(here.values()))
            at = np.linspace(known.min(), known.max(), 400)
            for name, values in here.items():
                color, dash = _look(names.index(name))
                axes.step(at, profile(values, at), label=_marked(name, values), color=color, linestyle=dash)
        title = f"performance profiles of {_trials(reached.values())}"
        _title(figure, title, reached.values(), layout)
        _legend_below(figure, axes_of.values())
    return figure


def _plot_performance(axes: Axes, row: int, reached: stats.FloatArray, rng: np.random.Generator) -> None:
    """Plot the performance of an agent's trials, (trials,), with their means."""
    axes.plot(reached, np.full(len(reached), row), "|", color="0.5", markersize=9, label=_once(row, "trial"))
    for statistic, name, marker, shift, color in (
        (stats.mean, "mean", "o", -0.2, _COLORS[0]),
        (stats.interquartile_mean, "interquartile mean", "D", 0.2, _COLORS[1]),
    ):
        value, low, high = stats.estimate([reached], statistic, rng)
        axes.plot([low, high], [row + shift] * 2, color=color)
        axes.plot(value, row + shift, marker, color=color, markersize=4, label=_once(row, name))


def save(figure: Figure, path: Path) -> None:
    """Write a figure as PNG, SVG or PDF, depending on the suffix of the file name.

    Raises:
        ExperimentError: the suffix is none of .png, .svg and .pdf, or the file cannot be written.
    """
    if path.suffix not in _METADATA:
        raise ExperimentError(f"a figure is saved as .png, .svg or .pdf, not as {path.name}")
    with _style(), written(path) as partial:
        figure.savefig(partial, format=path.suffix[1:], metadata=_METADATA[path.suffix])


_NOTHING: Final = "there is nothing to draw yet: no episode is finished"


@contextlib.contextmanager
def _style() -> Iterator[None]:
    with needing("plot", "figures need matplotlib", ExperimentError):
        import matplotlib
    with matplotlib.rc_context():
        matplotlib.rcdefaults()  # independent of the user's own style
        matplotlib.rcParams.update(_STYLE)
        yield


def _grid(
    panels: int,
    layout: Layout,
    share: Literal["all", "none"],
    height: float = _PANEL_HEIGHT,
    columns: int = 2,
) -> tuple[Figure, list[Axes], int]:
    """Return a figure, its panels, and the number of those side by side: `columns`, unless `layout` says it.

    Args:
        panels: their number.
        layout: of the figure.
        share: whether the panels have the same scales.
        height: of a panel, in inches.
        columns: the most panels side by side, by default.
    """
    from matplotlib.figure import Figure

    columns = min(layout.columns or columns, panels)
    rows = math.ceil(panels / columns)
    usual = (_WIDTH, _HEIGHT if rows == 1 and height == _PANEL_HEIGHT else _MARGIN + rows * height)
    figure = Figure(figsize=layout.size or usual)
    grid = list(figure.subplots(rows, columns, sharex=share, sharey=share, squeeze=False).flat)
    for axes in grid[panels:]:
        axes.remove()
    return figure, grid[:panels], columns


def _environments(
    curves: Iterable[Key], layout: Layout, across: str, up: str
) -> tuple[Figure, dict[str, Axes]]:
    """Return a figure with a panel for each environment, as their values have no common scale.

    Args:
        curves: those that it will have.
        layout: of the figure.
        across, up: labels of the axes.
    """
    names = list(dict.fromkeys(environment for environment, _ in curves))
    figure, panels, columns = _grid(len(names), layout, "none")
    for number, (name, axes) in enumerate(zip(names, panels, strict=True)):
        if name:
            axes.set_title(textwrap.fill(_literal(name), _TITLE_LETTERS // columns))
        if number + columns >= len(panels):  # no panel below
            axes.set_xlabel(_literal(across))
    if len(panels) == 1:
        panels[0].set_ylabel(_literal(up))
    else:
        figure.supylabel(_literal(up), fontsize="medium")
    return figure, dict(zip(names, panels, strict=True))


def _marked(name: str, trials: Sized) -> str:
    """Return a curve's name, marked if its interval is one of few trials."""
    shown = _literal(f" {name}" if name.startswith("_") else name)  # matplotlib's legends omit those with a _
    return shown + (FEW if len(trials) < stats.FEW_TRIALS else "")


def _literal(text: str) -> str:
    """Return a text of others for matplotlib, which would take what is between two $ for a formula."""
    return text.replace("$", r"\$")


def _title(figure: Figure, text: str, curves: Iterable[Sized], layout: Layout) -> None:
    """Write a title on as many lines as needed, with a warning if intervals have few trials."""
    if any(len(values) < stats.FEW_TRIALS for values in curves):
        text += f"; {FEW.strip()}\N{NO-BREAK SPACE}fewer than {stats.FEW_TRIALS} trials: unreliable"
    if layout.title is not None:
        text = layout.title
    figure.suptitle(textwrap.fill(text, _TITLE_LETTERS), fontsize="small", x=0.02, ha="left")


def _plot_mean(axes: Axes, returns: stats.FloatArray, window: int, name: str, dash: str, color: str) -> None:
    means = stats.mean(stats.running_mean(returns, window))
    axes.plot(np.arange(len(means)) + window, means, dash, color=color, linewidth=1.2, label=name)


def _legend_below(figure: Figure, panels: Iterable[Axes]) -> None:
    found: dict[str, Any] = {}
    for axes in panels:
        for handle, name in zip(*axes.get_legend_handles_labels(), strict=True):
            found.setdefault(name, handle)
    room = max(1, round(_LEGEND_LETTERS * figure.get_figwidth() / _WIDTH))
    columns = max(1, min(len(found), room // (max(map(len, found)) + 6)))
    figure.legend(found.values(), found.keys(), loc="outside lower center", ncols=columns, fontsize="small")


def fitting_window(window: int, lengths: Iterable[int]) -> int:
    """Return the window for curves of these lengths: a tenth of the longest if that is less than `window`.

    Raises:
        ExperimentError: there is nothing to plot yet.
    """
    longest = max(lengths, default=0)
    if not longest:
        raise ExperimentError(_NOTHING)
    return max(1, min(window, longest // 10))


def _look(number: int) -> tuple[str, str]:
    return _COLORS[number % len(_COLORS)], _DASHES[number % len(_DASHES)]


def _trials(curves: Iterable[Sized]) -> str:
    counts = sorted({len(returns) for returns in curves})
    return counted(counts[0], "trial") if len(counts) == 1 else f"{counts[0]} to {counts[-1]} trials"


def _once(row: int, name: str) -> str | None:
    return name if row == 0 else None
