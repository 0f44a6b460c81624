"""Start a run, or continue one that was interrupted.

A trial continues after its newest checkpoint. Episodes recorded after that are deleted and run again, with
the same results, since seeds and checkpoints determine them; so an interrupted run ends like an uninterrupted
one. A trial without a checkpoint starts over.

A run keeps a digest and a copy of each user file that its plan loads. It continues only with the same plan
and the same files, except that the plan may have more episodes or more trials.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Final, NamedTuple

from experiment_runner.plan.file import dump_plan, load_plan
from experiment_runner.plan.limits import BUDGETS
from experiment_runner.plan.plan import Plan, RoleSpec, RoleSweep, TrialSpec, absolute, differences
from experiment_runner.plan.provenance import about, program
from experiment_runner.plan.user_files import UserFile, changed_files, user_files
from experiment_runner.store import layout
from experiment_runner.store.database import holds_run, reported
from experiment_runner.store.layout import DirectoryTaken
from experiment_runner.store.results import Results
from experiment_runner.store.store import Store
from glue.errors import ConfigError, ExperimentError, HubUnreachable, Refused

FINISH: Final = "finish"
"""Kind of the event recorded when all trials of a run are finished."""


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


class Definition(NamedTuple):
    """The definition of a run that is made without a plan.

    specs    its trials
    files    contents of the files that describe it, by name
    players  the players whose files are copied, and may not change while the run is unfinished
    check    called with the store of a run in the directory; raises ExperimentError if it is another run
    """

    specs: Sequence[TrialSpec]
    files: Mapping[str, str]
    players: Sequence[RoleSpec | RoleSweep]
    check: Callable[[Store], None]


def open_run(
    directory: Path,
    run: Plan | Definition,
    *,
    say: Callable[[str], None] = lambda line: None,
) -> Store:
    """Return the store of a run: a new one, or the one in the directory, prepared to continue.

    Args:
        directory: contains the run, or will contain it.
        run: its plan, or what else defines it. The classes of its players must have been found.
        say: shows a line about each interrupted trial, and about an extension of the run.

    Raises:
        ExperimentError: the directory holds something else, is in use, or cannot be written to.
        DirectoryTaken: its run has another plan, or a file was changed since it began.
    """
    run = _defined_by(run, say) if isinstance(run, Plan) else run
    with reported(f"cannot open {directory}"):
        exists = holds_run(directory)
    with reported("cannot read a file of the user"):
        sources = user_files(run.players)
    if not exists:
        return _create(directory, run, sources)
    store = Store.open(directory)
    try:
        if layout.parts_of(directory):
            raise ExperimentError(
                f"tasks of a job array have trials of {directory}: when they are over, "
                f"glue-results gather {directory}"
            )
        if changed := changed_files(_recorded_files(directory), sources):
            here = "is not what its option names from this folder"
            found = [f"{file} {'has changed since' if file in sources else here}" for file in changed]
            begun = f"was begun with files of which {layout.SOURCES} has copies"
            raise DirectoryTaken(directory, f"{begun} ({'; '.join(found)})")
        run.check(store)
        store.record_event("resume", program())
        for record in store.trials():
            if record.finished and record.failure is not None:  # its cleanup may have failed
                store.rewind(record.spec.id, record.done)
        for trial in remaining(store):
            go_back(store, trial)
            if trial.after or trial.dropped:
                say(f"{trial.trial_id} {trial.course}")
    except BaseException:
        store.close()
        raise
    return store


def _create(directory: Path, run: Definition, sources: Mapping[str, UserFile]) -> Store:
    found = about()
    contents: dict[str, str | bytes] = {**run.files}
    for path, (sha256, content) in sources.items():
        found["files"][path] = {"sha256": sha256}
        if content is not None:
            name = layout.copy_of(Path(path), sha256)
            found["files"][path]["copy"] = name
            contents[name] = content
    contents[layout.ABOUT_FILE] = json.dumps(found, indent=2) + "\n"
    store = Store.create(directory, run.specs, contents)
    store.record_event("start", found["program"])
    return store


def _defined_by(plan: Plan, say: Callable[[str], None]) -> Definition:
    def check(store: Store) -> None:
        """Check that a run has this plan, or extend it if the plan is longer."""
        recorded = recorded_plan(store.directory)
        path = store.directory / layout.PLAN_FILE
        if not _extends([trial.spec for trial in store.trials()], recorded.expand()):
            raise ExperimentError(f"{path} was changed after its run began: put it back")
        counts = {
            name: max(was, getattr(plan, name))
            for name in (*BUDGETS, "trials")
            if (was := getattr(recorded, name))
        }
        longer = replace(recorded, **counts)
        # Runs of earlier versions have paths relative to the directory in which they began.
        if found := differences(*(absolute(one, Path.cwd()) for one in (longer, plan))):
            raise DirectoryTaken(store.directory, f"is the run of another plan ({'; '.join(found)})")
        if longer != recorded:
            say(f"{store.directory} is extended: {'; '.join(differences(recorded, longer))}")
            # Before the trials, so that a process killed in between leaves a plan that extends them.
            layout.replace_flushed(path, dump_plan(longer))
        if not layout.is_part(store.directory):  # the plan has trials of other parts, too
            lengthen(store, longer.expand(), say)

    return Definition(
        plan.expand(), {layout.PLAN_FILE: dump_plan(plan)}, [*plan.agents, *plan.environments], check
    )


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
                layout.remove_run(directory)
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
    path = directory / layout.PLAN_FILE
    if (directory / layout.COMPETITION_FILE).exists():
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


def _recorded_files(directory: Path) -> dict[str, str]:
    """Return path and SHA-256 of each user file with which a run, possibly merged, was begun."""
    about = layout.read_about(directory)
    found = {}
    for one in (about, *merged.values()) if isinstance(merged := about.get("merged"), dict) else (about,):
        files = one.get("files") if isinstance(one, dict) else None
        for path, file in files.items() if isinstance(files, dict) else ():
            if isinstance(file, dict) and isinstance(file.get("sha256"), str):
                found[path] = file["sha256"]
    return found
