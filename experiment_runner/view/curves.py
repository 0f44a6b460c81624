"""Learning curves as JSON: the numbers of `glue-plot` and `glue-results`, thinned out, and their drawing."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from experiment_runner.analysis.curves import Curve, of_metric, over_episodes, over_steps
from experiment_runner.analysis.settings import Setting, collect
from experiment_runner.analysis.stats import FloatArray, bootstrap_rng
from experiment_runner.report import svg
from experiment_runner.report.overview import setting_numbers
from experiment_runner.report.plots import fitting_window, step_window
from experiment_runner.store.records import MEASURES
from experiment_runner.store.results import opened
from experiment_runner.store.run_data import finite
from glue.console import did_you_mean
from glue.errors import ExperimentError

_HEIGHT: Final = 420  # of a drawing, in pixels
_TWO: Final = 700  # from this width on, two drawings stand side by side
_GAP: Final = 16
_WIDEST: Final = 1_000_000_000
_MOST_NUMBERS: Final = 8000  # of the single trials of a curve, at some 20 bytes each


class Wanted(NamedTuple):
    """The curves that a page requests.

    directories  of the runs that are compared
    window       episodes or steps in the running mean; at most a tenth of the longest curve is used; 0 for
                 the default, 100 episodes or a fiftieth of the steps
    over         `episodes` or `steps`
    span         the part that is shown, in the unit of `over`
    measure      name of one of `MEASURES`, or of a metric of the agents, which is always over steps
    """

    directories: tuple[Path, ...]
    window: int
    over: str
    span: tuple[float, float]
    measure: str = "return"


class Look(NamedTuple):
    """The width of a drawing in pixels, and whether each axis is logarithmic."""

    width: int
    log: tuple[bool, bool]


def curves(wanted: Wanted) -> dict[str, Any]:
    """Return the curves of some runs, and their table.

    Raises:
        ExperimentError: a run cannot be read, or two have a trial in common.
    """
    with opened(wanted.directories) as runs:
        names = list(dict.fromkeys(name for run in runs for name in run.metric_names()))
        if wanted.measure not in (known := [*MEASURES, *names]):
            raise ExperimentError(
                f"there is no measure {wanted.measure!r}{did_you_mean(wanted.measure, known)}"
            )
        is_metric = wanted.measure in names
        settings = collect(
            runs, "return" if is_metric else wanted.measure, wanted.measure if is_metric else ""
        )
        returns = settings if wanted.measure == "return" else collect(runs)
    begun = [setting for setting in settings if setting.curves().size]
    table = [{key: finite(value) for key, value in row.items()} for row in setting_numbers(returns)]
    shown = {"measure": wanted.measure, "measures": known}
    if not begun:
        return {"window": wanted.window, "curves": [], "settings": table, **shown}
    window = _window(wanted, begun)
    rng = bootstrap_rng()  # one for all curves, as in glue-plot
    drawn = [(setting, _curve(setting, window, wanted, rng)) for setting in begun]
    return {
        "window": window,
        "curves": [_as_json(setting, curve) for setting, curve in drawn if curve is not None],
        "settings": table,
        **shown,
    }


def drawn(found: dict[str, Any], over: str, look: Look) -> dict[str, Any]:
    """Return curves with a drawing for each environment, and a sample of each line for the legend.

    Args:
        found: the result of `curves`.
        over: `episodes` or `steps`.
        look: the size and scales of the drawing.
    """
    shown = [curve for curve in found["curves"] if curve["at"]]
    agents = list(dict.fromkeys(curve["agent"] for curve in shown))
    looks = [agents.index(curve["agent"]) for curve in shown]
    environments = list(dict.fromkeys(curve["environment"] for curve in shown))
    width = look.width if len(environments) < 2 or look.width < _TWO else (look.width - _GAP) // 2
    measure = MEASURES.get(found["measure"])
    axes = (over[:-1], measure.label) if measure else ("step", found["measure"])
    drawings = []
    for environment in environments:
        here = [number for number, curve in enumerate(shown) if curve["environment"] == environment]
        lines = [svg.Line(*(shown[number][name] for name in svg.Line._fields)) for number in here]
        drawing = svg.draw(lines, axes, (width, _HEIGHT), look.log, [looks[number] for number in here])
        drawings.append({"environment": environment, "curves": here, **drawing})
    return {
        **found,
        "drawings": drawings,
        "curves": [
            {name: value for name, value in curve.items() if name not in ("single_at", "singles")}
            | {"sample": svg.sample(number)}
            for number, curve in zip(looks, shown, strict=True)
        ],
    }


def _curve(setting: Setting, window: int, wanted: Wanted, rng: np.random.Generator) -> Curve | None:
    if setting.metrics:
        return of_metric([(metric.steps, metric.values) for metric in setting.metrics], rng, wanted.span)
    if wanted.over == "episodes":
        return over_episodes(setting.curves(), window, rng, wanted.span)
    return over_steps(setting.step_totals(), window, rng, wanted.span)


def _window(wanted: Wanted, begun: Sequence[Setting]) -> int:
    if wanted.over == "episodes":
        return fitting_window(wanted.window or 100, [setting.curves().shape[1] for setting in begun])
    return step_window(wanted.window, [setting.step_totals() for setting in begun])


def _as_json(setting: Setting, curve: Curve) -> dict[str, Any]:
    trials, points = curve.means.shape
    every = -(-points // max(1, min(points, _MOST_NUMBERS // trials)))
    single = range(0, points, every) if 2 * trials <= _MOST_NUMBERS else range(0)
    return {
        "label": setting.label,
        "agent": setting.agent,
        "environment": setting.environment,
        "trials": trials,
        "at": curve.at.tolist(),
        "mean": _numbers(curve.band.value),
        "low": _numbers(curve.band.low),
        "high": _numbers(curve.band.high),
        "single_at": [float(curve.at[i]) for i in single],
        "singles": [_numbers(line[list(single)]) for line in curve.means] if single else [],
    }


def _numbers(values: FloatArray) -> Sequence[object]:
    return [finite(value) for value in values.tolist()]


def wanted_by(directories: Sequence[Path], query: Any) -> tuple[Wanted, Look]:
    """Return the curves that a query requests, and their look: its `width`, and `log` for each of x and y.

    Raises:
        ExperimentError: a value is out of range.
    """
    over, measure, asked = query.get("over", "episodes"), query.get("measure", "return"), query.get("window")
    try:
        window = int(asked or (100 if over == "episodes" else 0))
        span = (float(query.get("from", "-inf")), float(query.get("to", "inf")))
        width = int(query.get("width", "800"))
    except ValueError:
        raise ExperimentError("window, from, to and width are numbers") from None
    if (
        not bool(asked) <= window <= _WIDEST
        or over not in ("episodes", "steps")
        or any(map(math.isnan, span))
    ):
        raise ExperimentError(
            "a window is from 1 to 1,000,000,000 episodes or steps, and curves are over episodes or steps"
        )
    log = query.getlist("log")
    look = Look(min(max(width, 280), 2000), ("x" in log, "y" in log))
    return Wanted(tuple(directories), window, over, span, measure), look
