"""`glue-plot`: plot the results of experiments."""

from __future__ import annotations

import shutil
import warnings
from collections import defaultdict
from pathlib import Path

import click

from experiment_runner.cli.options import over_option, select_option, selected
from glue import __version__
from glue.console import did_you_mean, say


def _size(context: click.Context, parameter: click.Parameter, text: str | None) -> tuple[float, float] | None:
    if text is None:
        return None
    width, _, height = text.partition("x")
    try:
        size = float(width), float(height)
    except ValueError:
        size = (0.0, 0.0)
    if not all(1 <= inches <= 50 for inches in size):
        raise click.BadParameter(f"write width and height in inches, from 1 to 50, as in 6.4x4; not {text}")
    return size


@click.command("glue-plot")
@click.argument("directories", metavar="RUN...", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option(
    "--out",
    "-o",
    type=click.Path(path_type=Path),
    help="File to write, .png, .svg or .pdf; without it, the curves are sketched in the terminal.",
)
@click.option(
    "--kind",
    type=click.Choice(["curves", "scatter", "comparison", "profile"]),
    default="curves",
    show_default=True,
    help="Learning curves with confidence bands; every episode as a dot, in a panel for each setting; or a "
    "comparison of the agents' final performance; or performance profiles, the share of trials above each "
    "final performance. Each environment has a panel.",
)
@click.option(
    "--measure",
    "--y",
    default="return",
    show_default=True,
    help="Column of the episodes that is plotted, also an extra of the environment or, with --over steps, "
    "reward: the reward per step.",
)
@click.option("--metric", default="", metavar="NAME", help="Plot a metric of the agents, over steps.")
@over_option
@click.option(
    "--window",
    type=click.IntRange(1),
    help="Episodes or steps in the running mean, or last ones that count as final performance. [default: 100 "
    "episodes, or a fiftieth of the steps]",
)
@click.option(
    "--band",
    type=click.Choice(["bootstrap", "tolerance"]),
    default="bootstrap",
    show_default=True,
    help="Bands of curves: 95 % bootstrap intervals of the mean, or tolerance intervals of "
    "single trials, which need at least 46.",
)
@select_option
@click.option("--title", metavar="TEXT", help="Title, in place of the description of what is drawn.")
@click.option("--size", callback=_size, metavar="WxH", help="Width and height in inches, as in 3.3x2.5.")
@click.option("--columns", type=click.IntRange(1, 20), metavar="N", help="Panels side by side. [default: 2]")
@click.version_option(__version__, prog_name="glue-plot")
def plot(
    directories: tuple[Path, ...],
    out: Path | None,
    kind: str,
    measure: str,
    metric: str,
    over: str,
    window: int | None,
    band: str,
    select: tuple[str, ...],
    title: str | None,
    size: tuple[float, float] | None,
    columns: int | None,
) -> None:
    """Plot the results of each RUN, a directory that glue-experiment created, also while it runs.

    \b
    Examples:
      glue-plot runs/mine
      glue-plot runs/mine -o curves.png
      glue-plot runs/mine --over steps -o curves.png
      glue-plot runs/mine --metric "mean TD error" -o errors.png
      glue-plot runs/mine runs/other --kind comparison -o comparison.svg
      glue-plot runs/sweep --select sarsa --size 6.4x3 --columns 3 -o sarsa.pdf
    """
    import numpy as np

    from experiment_runner.analysis.settings import REWARD, collect
    from experiment_runner.analysis.stats import FloatArray
    from experiment_runner.report import plots
    from experiment_runner.report.sketch import sketches
    from experiment_runner.report.tables import counted
    from experiment_runner.store.records import MEASURES
    from experiment_runner.store.results import opened
    from experiment_runner.store.run_data import extra_columns
    from glue.errors import ExperimentError

    warnings.simplefilter("ignore", RuntimeWarning)  # NumPy's: returns may be infinite or NaN
    if out is None and (kind != "curves" or over == "steps"):
        raise click.UsageError(f"--kind {kind} --over {over} needs a file: --out {kind}.png")
    tolerance = band == "tolerance"
    if tolerance and kind != "curves":
        raise click.UsageError(f"--band tolerance is for curves: leave out --kind {kind}")
    if kind == "scatter" and over == "steps":
        raise click.UsageError("a scatter plot has a dot for each episode: leave out --over steps")
    if out is None and (title is not None or size or columns):
        raise click.UsageError("--title, --size and --columns are for a file: --out curves.png")
    if metric and (out is None or kind != "curves"):
        raise click.UsageError("--metric draws curves and needs a file: --out metric.png")
    with opened(directories) as runs:
        extras = dict.fromkeys(name for run in runs for name in extra_columns(run))
        known = [*MEASURES, *extras, *([REWARD] if over == "steps" else [])]
        if measure not in known:
            raise click.UsageError(f"there is no measure {measure}{did_you_mean(measure, known)}")
        names = dict.fromkeys(name for run in runs for name in run.metric_names())
        if metric and metric not in names:
            near = did_you_mean(metric, names) or (
                "; glue-experiment records metrics with --metrics-every, of agents that have them"
            )
            raise click.UsageError(f"there is no metric {metric}{near}")
        found = selected(collect(runs, measure, metric), select)
    settings = [setting for setting in found if setting.curves().size]
    if settings and not metric and all(np.isnan(setting.curves()).all() for setting in settings):
        raise ExperimentError(f"there is nothing to draw: no episode has a value of {measure}")
    labels = {REWARD: "reward per step", **{name: known.label for name, known in MEASURES.items()}}
    label = metric or labels.get(measure, measure)
    layout = plots.Layout(title, size, columns or 0, label, tolerance)
    last = window or 100
    totals = {(s.environment, s.agent): s.step_totals() for s in settings} if over == "steps" else {}
    if totals:
        last = plots.step_window(window or 0, totals.values())
    if metric:
        readings = {
            (s.environment, s.agent): [(m.steps, m.values) for m in s.metrics if m.steps.size] for s in found
        }
        figure = plots.metric_curves(readings, layout)
    elif kind == "comparison":
        environments: dict[str, dict[str, FloatArray]] = defaultdict(dict)
        for setting in settings:
            environments[setting.environment][setting.agent] = setting.final(last, over)
        final = f"last {counted(last, over[:-1])}"
        figure = plots.comparison(environments, final=final, layout=layout)
    elif kind == "profile":
        reached = {(s.environment, s.agent): s.final(last, over) for s in settings}
        figure = plots.profiles(reached, layout=layout)
    elif totals:
        figure = plots.step_curves(totals, window=last, layout=layout)
    elif kind == "curves":
        curves = {(s.environment, s.agent): s.curves() for s in settings}
        if out is None:
            click.echo(sketches(curves, last, measure, shutil.get_terminal_size().columns))
            return
        figure = plots.learning_curves(curves, window=last, layout=layout)
    else:
        named = {setting.label: setting.curves() for setting in settings}
        figure = plots.scatter(named, window=last, layout=layout)
    assert out is not None
    plots.save(figure, out)
    say(f"wrote {out}")
