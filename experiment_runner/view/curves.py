"""Learning curves as JSON: the numbers of `glue-plot` and `glue-results`, reduced to what can be seen."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from experiment_runner.analysis.curves import Curve, over_episodes, over_steps
from experiment_runner.analysis.settings import Setting, collect
from experiment_runner.analysis.stats import FloatArray, bootstrap_rng
from experiment_runner.report.overview import setting_numbers
from experiment_runner.report.plots import fitting_window
from experiment_runner.store.output import finite
from experiment_runner.store.results import Results
from glue.errors import ExperimentError

__all__ = ["Wanted", "curves", "wanted_by"]

_WIDEST: Final = 1_000_000
_MOST_NUMBERS: Final = 8000  # of the single trials of a curve, at some 20 bytes each


class Wanted(NamedTuple):
    """What a page asks for.

    directories  of the runs that are compared
    window       episodes in the running mean; at most a tenth of the longest curve is used
    over         `episodes` or `steps`
    span         the part that is looked at, in what `over` says
    """

    directories: tuple[Path, ...]
    window: int
    over: str
    span: tuple[float, float]


def curves(wanted: Wanted) -> dict[str, Any]:
    """Return the curves of some runs, and the table beside them.

    Raises:
        ExperimentError: a run cannot be read, two have a trial in common, or SciPy is not installed.
    """
    with ExitStack() as stack:
        settings = collect([stack.enter_context(Results.open(path)) for path in wanted.directories])
    begun = [setting for setting in settings if setting.curves().size]
    table = [{key: finite(value) for key, value in row.items()} for row in setting_numbers(settings)]
    if not begun:
        return {"window": wanted.window, "curves": [], "settings": table}
    window = fitting_window(wanted.window, {setting.label: setting.curves() for setting in begun})
    rng = bootstrap_rng()  # one for all, as glue-plot draws them
    drawn = [(setting, _curve(setting, window, wanted, rng)) for setting in begun]
    return {
        "window": window,
        "curves": [_as_json(setting.label, curve) for setting, curve in drawn if curve is not None],
        "settings": table,
    }


def _curve(setting: Setting, window: int, wanted: Wanted, rng: np.random.Generator) -> Curve | None:
    if wanted.over == "episodes":
        return over_episodes(setting.curves(), window, rng, wanted.span)
    return over_steps(setting.curves(), setting.curve_steps(), window, rng, wanted.span)


def _as_json(label: str, curve: Curve) -> dict[str, Any]:
    trials, points = curve.means.shape
    every = -(-points // max(1, min(points, _MOST_NUMBERS // trials)))
    single = range(0, points, every) if 2 * trials <= _MOST_NUMBERS else range(0)
    return {
        "label": label,
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


def wanted_by(directories: Sequence[Path], query: Any) -> Wanted:
    """Return what the query of a request asks for.

    Raises:
        ExperimentError: it asks for something that does not exist.
    """
    try:
        window = int(query.get("window", "100"))
        span = (float(query.get("from", "-inf")), float(query.get("to", "inf")))
    except ValueError:
        raise ExperimentError("window, from and to are numbers") from None
    over = query.get("over", "episodes")
    if (
        not 1 <= window <= _WIDEST
        or over not in ("episodes", "steps")
        or span[0] != span[0]
        or span[1] != span[1]
    ):
        raise ExperimentError(
            "a window is from 1 to 1,000,000 episodes, and curves are over episodes or steps"
        )
    return Wanted(tuple(directories), window, over, span)
