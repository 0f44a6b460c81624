"""A run without its episodes, as JSON: results, plan, versions, machine; for a competition, its standings."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any, Final

from experiment_runner.competition.board.forms import LEGEND, as_json
from experiment_runner.competition.board.standings import standings
from experiment_runner.competition.course import course_of
from experiment_runner.report.overview import as_object
from experiment_runner.store.layout import ABOUT_FILE, COMPETITION_FILE, PLAN_FILE
from experiment_runner.store.results import Results
from experiment_runner.view.export import figures
from glue.files import read_regular

_MOST_NOTES: Final = 200  # voids and events, the newest; answers
_MOST_TEXT: Final = 2000  # of an answer
_MOST_TRIALS: Final = 1000
_MOST_BYTES: Final = 2**20  # of a text file


def run_in_full(directory: Path) -> dict[str, Any]:
    """Return everything that is known of a run, except its episodes.

    Raises:
        ExperimentError: the run cannot be read.
    """
    with Results.open(directory) as results:
        found: dict[str, Any] = as_object(results)
    for name, most in (("voids", _MOST_NOTES), ("events", _MOST_NOTES)):
        found[name + "_left_out"] = max(0, len(found[name]) - most)
        found[name] = found[name][-most:]
    for name, most in (("trial_records", _MOST_TRIALS), ("answers", _MOST_NOTES)):
        found[name + "_left_out"] = max(0, len(found[name]) - most)
        found[name] = found[name][:most]
    for answered in found["answers"]:
        answered["answer"] = answered["answer"][:_MOST_TEXT]
    competition = _text(directory / COMPETITION_FILE)
    for trial in found["trial_records"]:
        # As text, since JavaScript would round it; in a competition it is secret.
        trial["seed"] = "secret" if competition else str(trial["seed"])
    return found | {
        "plan": competition or _text(directory / PLAN_FILE),
        "competition": bool(competition),
        "about": _about(_text(directory / ABOUT_FILE)),
    }


def standings_of(directory: Path) -> dict[str, Any]:
    """Return the board of a competition and its progress, but nothing of the secret seed.

    Raises:
        ExperimentError: the directory holds no competition, or cannot be read.
    """
    with Results.open(directory) as results:
        course = course_of(directory)
        found = standings(results, course)
        board: dict[str, Any] = json.loads(as_json(found))
        over = results.outcomes()
        progress = {"matches": len(course.trials), "over": sum(trial in over for trial in course.trials)}
        return board | progress | {"legend": LEGEND, "figures": figures(found)}


def _about(text: str) -> dict[str, Any]:
    try:
        # A number that JSON lacks, or one too large to be read, is kept as text.
        about = json.loads(text, parse_constant=str, parse_float=_finite)
        json.dumps(about)
    except (ValueError, RecursionError):
        return {}
    return about if isinstance(about, dict) else {}


def _finite(text: str) -> float | str:
    return float(text) if math.isfinite(float(text)) else text


def _text(path: Path) -> str:
    """Return the contents of a text file; empty if it cannot be read, or should not."""
    try:
        return read_regular(path, _MOST_BYTES).decode("utf-8", "replace")
    except OSError:
        return ""
