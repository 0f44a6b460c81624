"""Merge several runs into one.

Runs of the same plan, from several machines, become one run of that plan; the longest record of each
trial is kept. Runs of different plans become a run without a plan, which can be read and plotted.
Different trials with the same id are prefixed with the name of their run.
"""

from __future__ import annotations

import json
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

from experiment_runner.plan.limits import TrialId
from experiment_runner.store.database import reported
from experiment_runner.store.layout import ABOUT_FILE, COMPETITION_FILE, PLAN_FILE
from experiment_runner.store.records import TrialRecord
from experiment_runner.store.results import Results
from experiment_runner.store.store import Store
from glue.errors import ExperimentError
from glue.files import read_text


class _Source(NamedTuple):
    run: Results
    record: TrialRecord


def merge(runs: Sequence[Results], directory: Path) -> None:
    """Create a run directory that holds the trials of all `runs`.

    Raises:
        ExperimentError: a run is a competition's, a trial has different results in two runs, two trials would
            have the same name, or the directory cannot be created. It is then left as it was.
    """
    for run in runs:
        if (run.directory / COMPETITION_FILE).is_file():
            raise ExperimentError(
                f"{run.directory} cannot be merged: it is a competition, whose scores are verified by its "
                f"own records; to read its episodes, use glue-results export {run.directory}"
            )
    sources = _choose(runs)
    plans = {_text(run.directory / PLAN_FILE) for run in runs}
    abouts = {str(run.directory): _about(run) for run in runs}
    files = {ABOUT_FILE: json.dumps({"merged": abouts}, indent=2) + "\n"}
    if len(plans) == 1 and all(plans):
        files[PLAN_FILE] = plans.pop()
    specs = [replace(source.record.spec, id=TrialId(name)) for name, source in sources.items()]

    def fill(store: Store) -> None:
        for name, source in sources.items():
            store.adopt(source.run, source.record.spec.id, name)

    Store.create(directory, specs, files, fill=fill).close()


def _about(run: Results) -> object:
    """Return the contents of run.json, which are kept but not interpreted; as text if they are not JSON."""
    text = _text(run.directory / ABOUT_FILE)
    try:
        about = json.loads(text)
        json.dumps(about, allow_nan=False)  # which would leave a run.json that cannot be read
        return about
    except (ValueError, RecursionError):
        return text


def _choose(runs: Sequence[Results]) -> dict[str, _Source]:
    """Return the source of each trial of the merged run, by its id in that run."""
    found: dict[str, list[_Source]] = defaultdict(list)
    for run in runs:
        for record in run.trials():
            found[record.spec.id].append(_Source(run, record))
    chosen: dict[str, _Source] = {}
    for trial_id, sources in found.items():
        groups: list[list[_Source]] = []
        for source in sources:
            for group in groups:
                if group[0].record.spec == source.record.spec:
                    group.append(source)
                    break
            else:
                groups.append([source])
        for group in groups:
            name = trial_id if len(groups) == 1 else f"{group[0].run.directory.name}/{trial_id}"
            if name in chosen:
                raise ExperimentError(
                    f"two trials would be called {name}: rename the directory of one of the runs"
                )
            chosen[name] = _longest(group)
    return chosen


def _longest(sources: Sequence[_Source]) -> _Source:
    longest = max(sources, key=lambda source: source.record.done)
    trial_id = longest.record.spec.id
    episodes = longest.run.episodes(trial_id)
    for other in sources:
        if other is longest:
            continue
        for ours, theirs in zip(episodes, other.run.episodes(trial_id), strict=False):
            if not ours.repeats(theirs):
                raise ExperimentError(
                    f"episode {ours.episode} of {trial_id} differs between {longest.run.directory} "
                    f"and {other.run.directory}, although the plan is the same"
                )
    return longest


def _text(path: Path) -> str:
    with reported(f"cannot read {path}"):
        return read_text(path) if path.exists() else ""
