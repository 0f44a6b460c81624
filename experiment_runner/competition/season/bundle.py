"""A bundle: everything with which others can verify a competition, and nothing that must be kept secret."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any, Final

from experiment_runner.competition.course import course_of
from experiment_runner.competition.records.copies import copies
from experiment_runner.competition.records.record import record_path
from experiment_runner.competition.records.seal import check_seal
from experiment_runner.competition.records.verify import not_installed
from experiment_runner.competition.season.forms import boards_as_json
from experiment_runner.store.database import reported
from experiment_runner.store.layout import (
    ABOUT_FILE,
    BOARD_FILE,
    COMPETITION_FILE,
    JOURNAL_FILE,
    SEAL_FILE,
    new_run,
    write_flushed,
)
from experiment_runner.store.results import Results
from experiment_runner.store.store import Store
from glue.errors import ExperimentError
from glue.files import read_regular

_FILES: Final = (COMPETITION_FILE, ABOUT_FILE, JOURNAL_FILE, SEAL_FILE)
_MOST_BYTES: Final = 2**32


def bundle(directory: Path, out: Path) -> list[str]:
    """Write a bundle of a run: its file, journal, seal, database, records, copies and boards.

    Returns:
        The names of the environments and their opponents that are not installed, and whose code the bundle
        does not hold.

    Raises:
        ExperimentError: the season is not closed, the run was changed since it was sealed, or a file cannot
            be read or written.
    """
    with Store.open(directory) as store, reported(f"cannot write {out}"):
        check_seal(store)
        course = course_of(directory)
        if course.in_season:
            raise ExperimentError(
                f"a bundle shows all levels, and the season is not closed: glue-compete close {directory}"
            )
        with new_run(out) as (folder, lock):
            for name in _FILES:
                write_flushed(folder / name, read_regular(directory / name, _MOST_BYTES))
            write_flushed(folder / BOARD_FILE, boards_as_json(store, course))
            for trial in store.outcomes():
                path = record_path(folder, trial)
                path.parent.mkdir(parents=True, exist_ok=True)
                write_flushed(path, read_regular(record_path(directory, trial), _MOST_BYTES))
            environments = [one for record in store.trials() if (one := record.spec.environment) is not None]
            for name, content in copies(environments, directory).items():
                write_flushed(folder / name, content)
            store.copy_to(folder)
        lock.release()
        return not_installed(store)


def board_differs(results: Results) -> bool:
    """Return whether a run has a board that is not that of its journal and records.

    Raises:
        ExperimentError: the board cannot be read or made.
    """
    path = results.directory / BOARD_FILE
    with reported(f"cannot read {path}"):
        if not path.is_file():
            return False
        text = read_regular(path, _MOST_BYTES)
    try:
        found = json.loads(text)
    except (ValueError, RecursionError):
        return True
    return not _same(found, json.loads(boards_as_json(results, course_of(results.directory))))


def _same(one: Any, other: Any) -> bool:
    """Return whether two values are equal, numbers but for the rounding that differs between processors."""
    if isinstance(one, dict) and isinstance(other, dict):
        return one.keys() == other.keys() and all(_same(value, other[key]) for key, value in one.items())
    if isinstance(one, list) and isinstance(other, list):
        return len(one) == len(other) and all(map(_same, one, other))
    if isinstance(one, float) and isinstance(other, float):
        return math.isclose(one, other, rel_tol=1e-9, abs_tol=1e-9)
    return bool(one == other)
