"""Start a run, or continue one that was interrupted.

A trial continues after its newest checkpoint. Episodes recorded after that are deleted and run again, with
the same results, since seeds and checkpoints determine them; so an interrupted run ends like one that was
not interrupted. A trial without a checkpoint starts over.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

from experiment_runner.plan import Plan, absolute, differences
from experiment_runner.plan_file import dump_plan, load_plan
from experiment_runner.provenance import about, program
from experiment_runner.store.database import holds_run, reported
from experiment_runner.store.layout import (
    ABOUT_FILE,
    COMPETITION_FILE,
    PLAN_FILE,
    how_to_go_on,
    remove_run,
)
from experiment_runner.store.results import Results
from experiment_runner.store.store import Store
from glue.errors import ConfigError, ExperimentError, HubUnreachable, Refused

__all__ = [
    "Remaining",
    "create_run",
    "go_back",
    "kept_if_begun",
    "open_run",
    "recorded_plan",
    "remaining",
    "resume_run",
]


class Remaining(NamedTuple):
    """A trial that is not finished.

    trial_id  of the trial
    after     the episode after which it continues, with `Store.checkpoint`; 0 for the beginning
    dropped   how many episodes recorded after that are run again
    """

    trial_id: str
    after: int
    dropped: int

    @property
    def course(self) -> str:
        """How it continues, as a text such as `continues after episode 200; 7 recorded episodes ...`."""
        where = f"continues after episode {self.after}" if self.after else "starts over"
        again = "1 recorded episode is" if self.dropped == 1 else f"{self.dropped} recorded episodes are"
        return f"{where}; {again} run again" if self.dropped else where


def create_run(directory: Path, plan: Plan, *, clock: Callable[[], float] = time.time) -> Store:
    """Return the store of a new run.

    Raises:
        ExperimentError: as `Store.create`.
    """
    files = {PLAN_FILE: dump_plan(plan), ABOUT_FILE: json.dumps(about(), indent=2) + "\n"}
    store = Store.create(directory, plan.expand(), files, clock=clock)
    store.record_event("start", program())
    return store


def resume_run(
    directory: Path, plan: Plan | None = None, *, clock: Callable[[], float] = time.time
) -> tuple[Store, list[Remaining]]:
    """Return the store of an interrupted run, prepared to continue, and the unfinished trials.

    Args:
        directory: contains the run.
        plan: the plan that the run must have; None for any.
        clock: returns seconds since 1970.

    Raises:
        ExperimentError: as `Store.open`; or the run has another plan, and the message names the
            differences.
    """
    store = Store.open(directory, clock=clock)
    try:
        _check_plan(store, plan)
        store.record_event("resume", program())
        for record in store.trials():
            if record.finished and record.failure is not None:  # as its cleanup may have
                store.rewind(record.spec.id, record.done)
        left = remaining(store)
        for trial in left:
            go_back(store, trial)
    except BaseException:
        store.close()
        raise
    return store, left


def open_run(
    directory: Path,
    plan: Plan,
    *,
    say: Callable[[str], None] = lambda line: None,
    clock: Callable[[], float] = time.time,
) -> Store:
    """Return the store of a plan's run: a new one, or the one in the directory, prepared to continue.

    Args:
        directory: contains the run, or will contain it.
        plan: of the run.
        say: shows a line about each interrupted trial.
        clock: returns seconds since 1970.

    Raises:
        ExperimentError: as `create_run` and `resume_run`.
    """
    with reported(f"cannot open {directory}"):
        exists = holds_run(directory)
    if not exists:
        return create_run(directory, plan, clock=clock)
    store, left = resume_run(directory, plan, clock=clock)
    for trial in left:
        if trial.after or trial.dropped:
            say(f"{trial.trial_id} {trial.course}")
    return store


@contextmanager
def kept_if_begun(directory: Path, say: Callable[[str], None]) -> Iterator[None]:
    """Remove a run that is new in this block if its hub did not let it in before anything was recorded.

    Args:
        directory: of the run, which is closed when the block ends.
        say: shows a line that tells how to continue a run that is kept.
    """
    with reported(f"cannot open {directory}"):
        was_there, had_folder = holds_run(directory), directory.exists()
    try:
        yield
    except (ConfigError, HubUnreachable, Refused):
        if holds_run(directory):
            with Results.open(directory) as results:
                begun = any(trial.done or trial.voids for trial in results.trials())
            if begun or was_there:
                say(f"nothing is lost: {how_to_go_on(directory)}")
            else:
                remove_run(directory)
                if had_folder:
                    directory.mkdir(exist_ok=True)
        raise


def recorded_plan(directory: Path) -> Plan:
    """Return the plan of the run in a directory.

    Raises:
        ExperimentError: there is no run, or it was merged from others, and has no plan.
    """
    with reported(f"cannot open {directory}"):
        if not holds_run(directory):
            raise ExperimentError(f"{directory} holds no run")
    path = directory / PLAN_FILE
    if (directory / COMPETITION_FILE).exists():
        raise ExperimentError(
            f"{directory} is a competition: go on with glue-compete run FILE --out {directory}"
        )
    if not path.exists():
        raise ExperimentError(f"{directory} was merged from other runs: go on with those")
    return load_plan(path)


def remaining(results: Results) -> list[Remaining]:
    """Return the trials that are not finished, in the order of the plan."""
    checkpointed = results.checkpointed()
    left = []
    for trial in results.trials():
        if not trial.finished:
            after = checkpointed.get(trial.spec.id, 0)
            left.append(Remaining(trial.spec.id, after, trial.done - after))
    return left


def go_back(store: Store, trial: Remaining) -> None:
    """Make a trial ready to go on: remove what it recorded past that point, and its failure."""
    if trial.dropped:
        store.record_event("rewind", trial.course, trial.trial_id)
    store.rewind(trial.trial_id, trial.after)


def _check_plan(store: Store, plan: Plan | None) -> None:
    recorded = recorded_plan(store.directory)
    if recorded.expand() != [trial.spec for trial in store.trials()]:
        path = store.directory / PLAN_FILE
        raise ExperimentError(f"{path} was changed after its run began: put it back")
    if plan is None:
        return
    # Runs of earlier versions have paths that are relative to where they began.
    if found := differences(*(absolute(one, Path.cwd()) for one in (recorded, plan))):
        raise ExperimentError(
            f"{store.directory} is the run of another plan ({'; '.join(found)}): "
            "choose another directory with --out"
        )
