"""Start a run, or continue one that was interrupted.

A trial continues after its newest checkpoint. Episodes recorded after that are deleted and run again, with
the same results, since seeds and checkpoints determine them; so an interrupted run ends like an uninterrupted
one. A trial without a checkpoint starts over.

A run keeps a digest and a copy of each user file that its plan loads. It continues only with the same plan
and the same files, except that the plan may have more episodes or more trials.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType
from typing import Final, NamedTuple

from experiment_runner.plan.file import dump_plan, load_plan
from experiment_runner.plan.limits import BUDGETS
from experiment_runner.plan.plan import Plan, RoleSpec, RoleSweep, TrialSpec, absolute, differences
from experiment_runner.plan.provenance import about, program
from experiment_runner.plan.user_files import UserFile, changed_files, user_files
from experiment_runner.store.database import holds_run, reported
from experiment_runner.store.layout import (
    ABOUT_FILE,
    COMPETITION_FILE,
    PLAN_FILE,
    SOURCES,
    is_part,
    parts_of,
    read_about,
    remove_run,
    replace_flushed,
)
from experiment_runner.store.lock import DirectoryTaken
from experiment_runner.store.results import Results
from experiment_runner.store.store import Store
from glue.errors import ConfigError, ExperimentError, HubUnreachable, Refused

FINISH: Final = "finish"
"""Kind of the event recorded when all trials of a run are finished."""


class OtherRun(DirectoryTaken):
    """A directory has a run of a different plan, or of files that were changed since.

    Attributes:
        differences: one line for each.
    """

    def __init__(self, directory: Path, what: str, differences: Sequence[str]) -> None:
        super().__init__(directory, f"{what} ({'; '.join(differences)})")
        self.differences = differences


class Remaining(NamedTuple):
    """A trial that is not finished.

    trial_id  the id of the trial
    after     the episode after which it continues, with `Store.checkpoint`; 0 for the beginning
    dropped   number of episodes recorded after that, which are run again
    """

    trial_id: str
    after: int
    dropped: int

    @property
    def course(self) -> str:
        """The continuation as a text such as `continues after episode 200; 7 recorded episodes ...`."""
        where = f"continues after episode {self.after}" if self.after else "starts over"
        again = "1 recorded episode is" if self.dropped == 1 else f"{self.dropped} recorded episodes are"
        return f"{where}; {again} run again" if self.dropped else where


def create_run(directory: Path, plan: Plan, *, clock: Callable[[], float] = time.time) -> Store:
    """Return the store of a new run.

    Raises:
        ExperimentError: as `Store.create`.
    """
    files = {PLAN_FILE: dump_plan(plan)}
    return create_trials(directory, plan.expand(), files, sources=sources_of(_players(plan)), clock=clock)


def create_trials(
    directory: Path,
    specs: Sequence[TrialSpec],
    files: Mapping[str, str],
    *,
    sources: Mapping[str, UserFile] = MappingProxyType({}),
    clock: Callable[[], float] = time.time,
) -> Store:
    """Return the store of a new run with these trials.

    Args:
        directory: contains the run.
        specs: its trials.
        files: contents of the files that define it, by name.
        sources: the user files that it loads, by path.
        clock: returns seconds since 1970.

    Raises:
        ExperimentError: as `Store.create`.
    """
    found = about()
    copies: dict[str, bytes] = {}
    for path, (sha256, content) in sources.items():
        found["files"][path] = {"sha256": sha256}
        if content is not None:
            name = f"{SOURCES}/{sha256[:12]}-{Path(path).name}"
            found["files"][path]["copy"] = name
            copies[name] = content
    contents: dict[str, str | bytes] = {**files, **copies, ABOUT_FILE: json.dumps(found, indent=2) + "\n"}
    store = Store.create(directory, specs, contents, clock=clock)
    store.record_event("start", found["program"])
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
        ExperimentError: as `Store.open`.
        OtherRun: the run has another plan, or a file was changed since it began.
    """
    return resume_trials(directory, lambda store: _match(store, plan, lambda line: None), clock=clock)


def resume_trials(
    directory: Path, check: Callable[[Store], None], *, clock: Callable[[], float] = time.time
) -> tuple[Store, list[Remaining]]:
    """Return the store of an interrupted run, prepared to continue, and the unfinished trials.

    Args:
        directory: contains the run.
        check: raises an error if the run is not the expected one.
        clock: returns seconds since 1970.

    Raises:
        ExperimentError: as `Store.open` and `check`.
    """
    store = Store.open(directory, clock=clock)
    try:
        if parts_of(directory):
            raise ExperimentError(
                f"tasks of a job array have trials of {directory}: when they are over, "
                f"glue-results gather {directory}"
            )
        check(store)
        store.record_event("resume", program())
        for record in store.trials():
            if record.finished and record.failure is not None:  # its cleanup may have failed
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
    files = {PLAN_FILE: dump_plan(plan)}
    return open_trials(
        directory,
        plan.expand(),
        files,
        lambda store: _match(store, plan, say),
        sources=sources_of(_players(plan)),
        say=say,
        clock=clock,
    )


def open_trials(
    directory: Path,
    specs: Sequence[TrialSpec],
    files: Mapping[str, str],
    check: Callable[[Store], None],
    *,
    sources: Mapping[str, UserFile] = MappingProxyType({}),
    say: Callable[[str], None] = lambda line: None,
    clock: Callable[[], float] = time.time,
) -> Store:
    """Return the store of a run: a new one, or the one in the directory, prepared to continue.

    Args:
        directory, specs, files, sources: as `create_trials`.
        check: as `resume_trials`.
        say: shows a line about each interrupted trial.
        clock: returns seconds since 1970.

    Raises:
        ExperimentError: as `create_trials` and `resume_trials`.
    """
    with reported(f"cannot open {directory}"):
        exists = holds_run(directory)
    if not exists:
        return create_trials(directory, specs, files, sources=sources, clock=clock)
    store, left = resume_trials(directory, check, clock=clock)
    for trial in left:
        if trial.after or trial.dropped:
            say(f"{trial.trial_id} {trial.course}")
    return store


@contextmanager
def kept_if_begun(directory: Path, kept: Callable[[], None]) -> Iterator[None]:
    """Remove a run created in this block if it is refused before anything was recorded.

    A run is refused by its hub, or because its players cannot be started.

    Args:
        directory: of the run, which is closed when the block ends.
        kept: called if the run is kept, before the error is raised again.
    """
    with reported(f"cannot open {directory}"):
        was_there, had_folder = holds_run(directory), directory.exists()
    try:
        yield
    except (ConfigError, HubUnreachable, Refused):
        if holds_run(directory):
            with Results.open(directory) as results:
                begun = any(trial.done or trial.voids for trial in results.trials()) or results.outcomes()
            if begun or was_there:
                kept()
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
        raise ExperimentError(f"{directory} is a competition, which glue-compete run continues")
    if not path.exists():
        raise ExperimentError(f"{directory} was merged from other runs: continue those")
    plan = load_plan(path, "id", follow=False)  # a line says so in the plan of every later version
    if plan.tune is not None:
        raise ExperimentError(f"{directory} is a part of {directory.parent}, which its plan continues")
    return plan


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
    """Prepare a trial to continue: delete its episodes after `trial.after`, and its failure."""
    if trial.dropped:
        store.record_event("rewind", trial.course, trial.trial_id)
    store.rewind(trial.trial_id, trial.after)


def finished_at(results: Results) -> float | None:
    """Return the time at which a run was finished, in seconds since 1970; None if it was not recorded."""
    return max((event.time for event in results.events() if event.kind == FINISH), default=None)


def _match(store: Store, plan: Plan | None, say: Callable[[str], None]) -> None:
    """Check that a run has this plan, None for any, and the same files; extend it if the plan is longer."""
    recorded = longer = recorded_plan(store.directory)
    path = store.directory / PLAN_FILE
    if not _extends([trial.spec for trial in store.trials()], recorded.expand()):
        raise ExperimentError(f"{path} was changed after its run began: put it back")
    if plan is not None:
        counts = {
            name: max(was, getattr(plan, name))
            for name in (*BUDGETS, "trials")
            if (was := getattr(recorded, name))
        }
        longer = replace(recorded, **counts)
        # Runs of earlier versions have paths relative to the directory in which they began.
        if found := differences(*(absolute(one, Path.cwd()) for one in (longer, plan))):
            raise OtherRun(store.directory, "is the run of another plan", found)
        if longer != recorded:
            say(f"{store.directory} is extended: {'; '.join(differences(recorded, longer))}")
    check_sources(store.directory, sources_of(_players(plan or recorded)))
    if longer != recorded:
        # Before the trials, so that a process killed in between leaves a plan that extends them.
        replace_flushed(path, dump_plan(longer))
    if not is_part(store.directory):  # the plan has trials of other parts, too
        lengthen(store, longer.expand(), say)


def lengthen(store: Store, specs: Sequence[TrialSpec], say: Callable[[str], None]) -> None:
    """Add trials to a run, or make its trials longer.

    Args:
        store: of the run.
        specs: new trials, or trials of the run with at least their length.
        say: shows a line about each trial that has to start over.
    """
    longer = {spec.id: spec.steps for spec in specs}
    for trial in store.trials():
        spec = trial.spec
        if spec.steps < longer.get(spec.id, 0) and store.cut_by_budget(spec.id):
            store.rewind(spec.id, 0)  # the longer trial does not cut off that episode
            say(f"{spec.id} starts over: its budget of steps has cut off its last episode")
    store.extend(specs)


def _extends(stored: Sequence[TrialSpec], planned: Sequence[TrialSpec]) -> bool:
    """Return whether the stored trials are planned, with at least their length."""
    found = {spec.id: spec for spec in planned}
    return all(
        (longer := found.get(spec.id)) is not None
        and replace(spec, episodes=longer.episodes, steps=longer.steps) == longer
        and spec.episodes <= longer.episodes
        and spec.steps <= longer.steps
        for spec in stored
    )


def sources_of(players: Sequence[RoleSpec | RoleSweep]) -> Mapping[str, UserFile]:
    """Return the user files that players load, by path. Their classes must have been found.

    Raises:
        StorageError: a file cannot be read.
    """
    with reported("cannot read a file of the user"):
        return user_files(players)


def check_sources(directory: Path, sources: Mapping[str, UserFile]) -> None:
    """Check that a run was begun with the same user files.

    Raises:
        OtherRun: a file has changed since.
    """
    if changed := changed_files(_recorded_files(directory), sources):
        found = [f"{file} has changed since" for file in changed]
        raise OtherRun(directory, f"was begun with files of which {SOURCES} has copies", found)


def _players(plan: Plan) -> list[RoleSweep]:
    return [*plan.agents, *plan.environments]


def _recorded_files(directory: Path) -> dict[str, str]:
    """Return path and SHA-256 of each user file with which a run, possibly merged, was begun."""
    about = read_about(directory)
    found = {}
    for one in (about, *merged.values()) if isinstance(merged := about.get("merged"), dict) else (about,):
        files = one.get("files") if isinstance(one, dict) else None
        for path, file in files.items() if isinstance(files, dict) else ():
            if isinstance(file, dict) and isinstance(file.get("sha256"), str):
                found[path] = file["sha256"]
    return found
