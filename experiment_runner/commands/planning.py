"""What `glue-experiment` is to run: the plan that its options describe, and the directory of the results."""

from __future__ import annotations

import itertools
import sys
import time
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import click

from experiment_runner.plan import REMOTE, Plan, RoleSweep, absolute, check_options, class_files
from experiment_runner.plan_file import load_plan
from glue.errors import ConfigError, ExperimentError
from glue.options import parse_assignments
from glue.players.loading import find, names
from glue.protocol.messages import Role

__all__ = ["ask_for_trust", "make_plan", "new_directory", "role_sweeps"]


def role_sweeps(role: Role, name: str | None, assignments: tuple[str, ...]) -> tuple[RoleSweep, ...]:
    """Return the agent or environment of the command line as a plan has it; none if it joins from outside.

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
    """Return the checked plan of a file, with `counts` in the place of its own, or of `counts` and `roles`.

    Raises:
        ConfigError: the plan is wrong, or no number of episodes is given.
    """
    try:
        if plan_file is None:
            if "episodes" not in counts:
                raise ConfigError("give the number of --episodes, or a --plan, or a run to --resume")
            plan = absolute(Plan(**counts, **roles), Path.cwd())
        else:
            plan = absolute(replace(load_plan(plan_file), **counts), plan_file.parent)
        plan = check_options(plan, lambda role, name: find(Role(role), name))
        plan.expand()  # raises an error, before anything is created, if a trial occurs twice
    except ExperimentError as error:  # a mistake in a plan is one in the command
        raise ConfigError(str(error)) from error
    return plan


def ask_for_trust(directory: Path, plan: Plan) -> None:
    """Ask before executing the files that a run directory names: it may come from anyone.

    Raises:
        ConfigError: the answer is no, or there is nobody to ask.
    """
    files = ", ".join(class_files([*plan.agents, *plan.environments]))
    if not files:
        return
    if not sys.stdin.isatty():
        raise ConfigError(f"{directory} would execute {files}: if you trust it, add --trust")
    if not click.confirm(f"{directory} will execute {files}. Do you trust it?", err=True):
        raise ConfigError(f"{directory} is not trusted, and was left as it is")


def new_directory(plan: Plan, plan_file: Path | None) -> Path:
    """Return a directory in runs/ that does not exist: the time, and the file's or the players' names."""
    labels = [sweeps[0].label for sweeps in (plan.agents, plan.environments) if sweeps]
    name = plan_file.stem if plan_file else "-".join(labels) or REMOTE
    first = Path("runs") / f"{time.strftime('%Y%m%d-%H%M%S')}-{name}"
    candidates = itertools.chain([first], (Path(f"{first}-{number}") for number in itertools.count(2)))
    return next(path for path in candidates if not path.exists())
