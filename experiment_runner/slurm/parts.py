"""Divide the unfinished trials of a run among tasks, and gather the results of the tasks.

A part is a run directory in the folder `parts` of its run, with the same plan and some of the trials. One
task continues it like any other run, so that no two processes write to the same database.
"""

from __future__ import annotations

from functools import partial

from experiment_runner.store.database import reported
from experiment_runner.store.layout import ABOUT_FILE, PARTS, PLAN_FILE, parts_of, remove_run
from experiment_runner.store.store import Store
from glue.files import read_text


def divide(store: Store, tasks: int) -> int:
    """Make a part for each task, named by its number from 0; return the number of parts.

    Args:
        store: of the run, which has no parts.
        tasks: maximum number of parts. Their numbers of trials differ by at most one.

    Raises:
        ExperimentError: a part cannot be written.
    """
    left = [trial for trial in store.trials() if not trial.finished]
    with reported(f"cannot read {store.directory}"):
        files = {name: read_text(store.directory / name) for name in (PLAN_FILE, ABOUT_FILE)}
    count = min(tasks, len(left))
    for number in range(count):
        share = left[number::count]
        Store.create(
            store.directory / PARTS / str(number),
            [trial.spec for trial in share],
            files,
            fill=partial(_copy, store, [trial.spec.id for trial in share if trial.done]),
        ).close()
    return count


def _copy(source: Store, trial_ids: list[str], part: Store) -> None:
    for trial_id in trial_ids:
        part.adopt(source, trial_id, trial_id)


def gather(store: Store) -> int:
    """Move the results of all parts to their run; return the number of parts.

    A kill in between loses nothing: a part is removed after its results are stored.

    Raises:
        DirectoryTaken: a task is running.
        ExperimentError: a part cannot be read, or the results cannot be written.
    """
    parts = parts_of(store.directory)
    for path in parts:
        with Store.open(path) as part:
            for trial in part.trials():
                if trial.done >= store.done(trial.spec.id):
                    store.adopt(part, trial.spec.id, trial.spec.id)
        with reported(f"cannot remove {path}"):
            remove_run(path)
    return len(parts)
