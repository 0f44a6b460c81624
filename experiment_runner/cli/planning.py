"""Turn the options of `glue-experiment` into a plan and a directory for its results."""

from __future__ import annotations

import itertools
import sys
import time
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import click

from experiment_runner.plan.file import parse_plan
from experiment_runner.plan.ids import REMOTE
from experiment_runner.plan.limits import BUDGETS
from experiment_runner.plan.plan import Plan, RoleSweep, absolute, budget, check_options, class_files
from experiment_runner.plan.toml import naming_lines, read
from experiment_runner.plan.user_files import with_digests
from glue.errors import ConfigError, ExperimentError
from glue.options import parameters, parse_assignments
from glue.plugins import loading
from glue.plugins.loading import find, names
from glue.wire.messages import Role


def role_sweeps(role: Role, name: str | None, assignments: tuple[str, ...]) -> tuple[RoleSweep, ...]:
    """Return the command line's agent or environment in a plan's form; none if it joins from outside.

    Raises:
        ConfigError: options are given without a name, the name is unknown, or an option is malformed.
    """
    flag = "env" if role is Role.ENVIRONMENT else "agent"
    if name is None:
        if assignments:
            raise ConfigError(
                f"--{flag}-option needs --{flag} NAME (there are {', '.join(names(role))}); an {role} that "
                f"joins from outside takes its options on its own command line"
            )
        return ()
    return (RoleSweep(name, parse_assignments(find(role, name), assignments)),)


def make_plan(plan_file: Path | None, counts: Mapping[str, Any], roles: Mapping[str, Any]) -> Plan:
    """Return the checked plan of a file, with `counts` in place of its own, or of `counts` and `roles`.

    Raises:
        ConfigError: the plan is wrong, or no number of episodes or steps is given.
    """
    try:
        if plan_file is not None:
            text = read(plan_file, "plan")
            with naming_lines(plan_file, text):
                plan = parse_plan(text)
            plan = absolute(replace(plan, **budget(counts)), plan_file.parent)
            with naming_lines(plan_file, text):
                return _checked(plan)
        if not any(name in counts for name in BUDGETS):
            raise ConfigError("give the number of --episodes or --steps, or a --plan, or a run to --resume")
        return _checked(absolute(Plan(**counts, **roles), Path.cwd()))
    except ExperimentError as error:  # a mistake in a plan is a mistake in the command
        raise ConfigError(str(error)) from error


def _checked(plan: Plan) -> Plan:
    """Return a plan with its options checked; an error is raised before anything is created."""
    plan = check_options(plan, _find)
    plan.expand()  # raises an error if a trial occurs twice
    agents, environments = _pinned(Role.AGENT, plan.agents), _pinned(Role.ENVIRONMENT, plan.environments)
    return replace(plan, agents=agents, environments=environments)


def _pinned(role: Role, sweeps: Iterable[RoleSweep]) -> tuple[RoleSweep, ...]:
    """Return agents or environments with the digests of the files that their options name."""
    from experiment_runner.store.database import reported

    with reported("cannot read a file of the user"):
        return tuple(
            replace(sweep, options=with_digests(sweep.options, parameters(find(role, sweep.name))))
            for sweep in sweeps
        )


def _find(role: str, name: str) -> type:
    return find(Role(role), name)


def find_players(plan: Plan) -> None:
    """Import the classes of a plan, so that their files are known.

    Raises:
        ConfigError: a class does not exist, or cannot be imported.
    """
    for role, sweeps in ((Role.ENVIRONMENT, plan.environments), (Role.AGENT, plan.agents)):
        for sweep in sweeps:
            find(role, sweep.name)


def without_seed(plan: Plan) -> list[str]:
    """Return a line for each of the user's agents and environments that takes no seed.

    Raises:
        ConfigError: a class does not exist, or cannot be imported.
    """
    roles = ((Role.ENVIRONMENT, plan.environments), (Role.AGENT, plan.agents))
    lines = [
        loading.without_seed(role, sweep.label, find(role, sweep.name))
        for role, sweeps in roles
        for sweep in sweeps
    ]
    return [line for line in lines if line is not None]


def ask_for_trust(directory: Path, plan: Plan) -> None:
    """Ask before executing the files that a run directory names: the directory may come from anyone.

    Raises:
        ConfigError: the answer is no, or standard input is not a terminal.
    """
    files = ", ".join(class_files([*plan.agents, *plan.environments]))
    if not files:
        return
    if not sys.stdin.isatty():
        raise ConfigError(f"{directory} would execute {files}: if you trust it, add --trust")
    if not click.confirm(f"{directory} will execute {files}. Do you trust it?", err=True):
        raise ConfigError(f"{directory} is not trusted, and was left as it is")


def names_of(plan: Plan) -> str:
    """Return the names of the players of a plan, for the name of a directory."""
    return "-".join(sweeps[0].label for sweeps in (plan.agents, plan.environments) if sweeps) or REMOTE


@contextmanager
def own_directory(given: Path | None, name: str) -> Iterator[Path]:
    """Yield the directory of a run: the given one, or a new one in runs/, named by the time and `name`.

    A new one is made at once, as another run may begin in the same second; it is removed if it stays empty.

    Raises:
        ExperimentError: it cannot be made.
    """
    from experiment_runner.store.database import reported

    if given is not None:
        yield given
        return
    first = Path("runs") / f"{time.strftime('%Y%m%d-%H%M%S')}-{name}"
    for path in itertools.chain([first], (Path(f"{first}-{number}") for number in itertools.count(2))):
        with reported(f"cannot make {path}"), suppress(FileExistsError):
            path.mkdir(parents=True)
            break
    try:
        yield path
    finally:
        with suppress(OSError):
            path.rmdir()
            path.parent.rmdir()
