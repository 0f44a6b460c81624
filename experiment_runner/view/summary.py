"""A run in full, as JSON: its results, plan, versions and machine."""

from __future__ import annotations

import json
import os
import stat
from pathlib import Path
from typing import Any, Final

from experiment_runner.report.overview import as_object
from experiment_runner.store.layout import ABOUT_FILE, COMPETITION_FILE, PLAN_FILE
from experiment_runner.store.results import Results

__all__ = ["run_in_full"]

_MOST_NOTES: Final = 200  # voids and events, the newest; answers
_MOST_TEXT: Final = 2000  # of an answer
_MOST_TRIALS: Final = 1000
_MOST_BYTES: Final = 2**20  # of a text file


def run_in_full(directory: Path) -> dict[str, Any]:
    """Return everything that is known of a run but its episodes.

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
        # As text, since JavaScript would round it; of a competition it is secret.
        trial["seed"] = "secret" if competition else str(trial["seed"])
    return found | {
        "plan": competition or _text(directory / PLAN_FILE),
        "competition": bool(competition),
        "about": _about(_text(directory / ABOUT_FILE)),
    }


def _about(text: str) -> dict[str, Any]:
    try:
        about = json.loads(text)
    except (ValueError, RecursionError):
        return {}
    return about if isinstance(about, dict) else {}


def _text(path: Path) -> str:
    """Return the contents of a text file, if there is one; a run from elsewhere may link to anything."""
    try:
        file = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK)
    except OSError:
        return ""
    with os.fdopen(file, "rb") as opened:
        if not stat.S_ISREG(os.fstat(file).st_mode):
            return ""
        return opened.read(_MOST_BYTES).decode("utf-8", "replace")
