"""A run's copies of the files that its environments read, such as levels: with them it is verified elsewhere.

Beside an option that names such a file is one with its SHA-256, as `level_digest` beside `level`, which the
environment compares with what it reads: a copy cannot be another level.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path

from experiment_runner.plan.plan import RoleSpec, TrialSpec
from experiment_runner.plan.user_files import file_at
from experiment_runner.store.database import reported
from experiment_runner.store.layout import copy_of
from glue.errors import ExperimentError
from glue.plugins.loading import file_in
from glue.trajectory import Run


def copies(environments: Iterable[RoleSpec | None], directory: Path) -> dict[str, bytes]:
    """Return the contents of the files that environments read, by the places of the copies in a run.

    Args:
        environments: of trials.
        directory: of their run, whose own copies are read if it has any.

    Raises:
        ExperimentError: a file cannot be read, or has changed.
    """
    found: dict[str, bytes] = {}
    for environment in environments:
        for _, path, sha256, copy in _files(environment):
            if copy in found:
                continue
            with reported("cannot read a file of an environment"):
                present, content = file_at(_nearest(path, directory / copy))
            if present != sha256:
                raise ExperimentError(f"{path} has changed since the run began: put it back")
            if content is not None:
                found[copy] = content
    return found


def with_copies(spec: TrialSpec, directory: Path) -> TrialSpec:
    """Return a trial whose environment reads the copies that its run has, in place of the files."""
    if spec.environment is None:
        return spec
    read = {name: str(_nearest(path, directory / copy)) for name, path, _, copy in _files(spec.environment)}
    options = {**spec.environment.options, **read}
    return replace(spec, environment=replace(spec.environment, options=options))


def without_places(run: Run) -> Run:
    """Return the run of a recording without the places of its environment and of files with digests."""
    options = {name: value for name, value in run.options.items() if f"{name}_digest" not in run.options}
    return replace(run, environment=without_place(run.environment), options=options)


def without_place(name: str) -> str:
    """Return the name of an environment, in which a file has no folder."""
    file = file_in(name)
    return name.replace(file, Path(file).name, 1) if file else name


def _files(environment: RoleSpec | None) -> Iterator[tuple[str, Path, str, str]]:
    """Yield option, path, SHA-256 and place of the copy of each file that an environment reads."""
    options = {} if environment is None else environment.options
    for name, value in options.items():
        if (sha256 := options.get(f"{name}_digest")) is not None:
            path = Path(str(value))
            yield name, path, str(sha256), copy_of(path, str(sha256))


def _nearest(path: Path, copy: Path) -> Path:
    return copy if copy.is_file() else path
