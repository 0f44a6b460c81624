"""Turn the options of `glue-experiment` into a plan, a hub, and a directory for the results."""

from __future__ import annotations

import itertools
import sys
import time
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import click
from click.core import ParameterSource

from experiment_runner.executors.job import HubOptions
from experiment_runner.executors.opening import recorded_plan
from experiment_runner.plan.file import parse_plan
from experiment_runner.plan.limits import BUDGETS, COUNTS, PACE, PLAYERS, REMOTE, Backend
from experiment_runner.plan.metrics import MetricsPlan, Summary, check_extras, parse_extras
from experiment_runner.plan.plan import Plan, RoleSweep, absolute, budget, check_options
from experiment_runner.plan.toml import naming_lines, read
from experiment_runner.plan.user_files import named_code, with_digests
from experiment_runner.store.database import reported
from glue.console import one_line
from glue.errors import ConfigError, ExperimentError
from glue.hub.config import DEFAULT_SESSION, LegacyPort, check_session, check_url
from glue.options import parameters, parse_assignments
from glue.plugins.loading import find, names
from glue.wire.messages import Role


def planned(options: SimpleNamespace) -> tuple[Plan, Path | None]:
    """Return the plan that the options describe, and the directory of its run; None for a new one.

    Raises:
        ConfigError: the options contradict each other, or the plan is wrong.
        ExperimentError: there is no run to continue, or it cannot be read.
    """
    file, resume = options.plan_file, options.resume
    if file is not None and (
        options.agent or options.environment or options.agent_option or options.env_option
    ):
        raise ConfigError(
            f"{file} names the agents and environments: leave out --agent and --env, and write "
            "their options into the plan, below [agents.NAME] or [environments.NAME], instead of giving "
            "--agent-option and --env-option"
        )
    given = {name: getattr(options, name) for name in (*COUNTS, *PACE)}
    counts = {name: value for name, value in given.items() if value is not None}
    if options.metrics_every is not None:
        counts["metrics"] = MetricsPlan(options.metrics_every)
    if options.metric:
        counts["extras"] = _extras(options.metric)
    roles = {
        "environments": role_sweeps(Role.ENVIRONMENT, options.environment, options.env_option),
        "agents": role_sweeps(Role.AGENT, options.agent, options.agent_option),
    }
    if resume is None:
        if options.again and options.out is None:
            raise ConfigError("--again replaces the run in a directory: name it with --out")
        plan = make_plan(file, counts, roles)
        return plan, options.out
    others = any(roles.values()) or file or options.out or options.again
    if others or counts.keys() - {*BUDGETS, "trials"}:
        raise ConfigError(
            f"--resume continues the run in {resume} with its own plan: "
            "leave out --plan, --out, --again, and options that change a plan, except more --episodes, "
            "--steps or --trials"
        )
    plan = replace(recorded_plan(resume), **budget(counts))
    if not options.dry_run:
        if not options.trust:
            ask_for_trust(resume, plan)
        for role, sweeps in ((Role.ENVIRONMENT, plan.environments), (Role.AGENT, plan.agents)):
            for sweep in sweeps:
                find(role, sweep.name)  # imports the class, so that its files are known
    return plan, resume


def hub_options(options: SimpleNamespace) -> HubOptions:
    """Return the hub that the options describe.

    An environment variable is ignored, not refused, where no hub is used.

    Raises:
        ConfigError: options contradict each other, or an address is malformed.
    """
    in_process = options.in_process or PLAYERS.keys() <= {*options.inside}
    isolated = in_process or options.workers or options.engine != Backend.LOCAL
    ours = {"--bind": options.bind, "--legacy-port": options.legacy_port, "--keys": options.keys}
    hub = None if _from_variable("hub") and (isolated or any(ours.values())) else options.hub
    session = DEFAULT_SESSION if _from_variable("session") and isolated else options.session
    found = HubOptions(
        hub,
        tuple(dict.fromkeys(options.bind)),
        check_session(session),
        options.wait if hub else None,
        options.insecure,
        # Each port is opened once, even if it is given twice.
        tuple(
            dict.fromkeys(LegacyPort.parse(port, session, options.insecure) for port in options.legacy_port)
        ),
        options.key if hub or not _from_variable("key") else None,
        options.hub_key if hub or not _from_variable("hub_key") else None,
        options.keys,
    )
    theirs = {"--key": found.key, "--hub-key": found.hub_key}
    flag = next((flag for flag, value in (theirs if hub is None else ours).items() if value), None)
    if flag is not None and hub is None:
        raise ConfigError(f"{flag} is for a running hub: name it with --hub")
    if flag is not None:
        raise ConfigError(
            f"{flag} is for a hub that the experiment starts, and --hub names a running one: leave one out"
        )
    for url in (*found.bind, *([hub] if hub else [])):
        check_url(url)
    return found


def _from_variable(option: str) -> bool:
    """Return whether an option was set by an environment variable."""
    return click.get_current_context().get_parameter_source(option) is ParameterSource.ENVIRONMENT


def _extras(metrics: Iterable[str]) -> dict[str, Summary]:
    pairs = [metric.rpartition("=") for metric in metrics]
    for name, _, how in pairs:
        if not name:
            raise ConfigError(f"a metric is an extra and what is recorded of it, as in coins=last, not {how}")
    try:
        check_extras([name for name, _, _ in pairs], [""])
        return parse_extras({name: how for name, _, how in pairs})
    except ExperimentError as error:
        raise ConfigError(str(error)) from None


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
    plan = check_options(plan, lambda role, name: find(Role(role), name))
    plan.expand()  # raises an error if a trial occurs twice
    agents, environments = _pinned(Role.AGENT, plan.agents), _pinned(Role.ENVIRONMENT, plan.environments)
    return replace(plan, agents=agents, environments=environments)


def _pinned(role: Role, sweeps: Iterable[RoleSweep]) -> tuple[RoleSweep, ...]:
    """Return agents or environments with the digests of the files that their options name."""
    with reported("cannot read a file of the user"):
        return tuple(
            replace(sweep, options=with_digests(sweep.options, parameters(find(role, sweep.name))))
            for sweep in sweeps
        )


def ask_for_trust(directory: Path, plan: Plan) -> None:
    """Ask before running code, or asking servers, that a run directory names: it may come from anyone.

    Raises:
        ConfigError: the answer is no, or standard input is not a terminal.
    """
    code = one_line(", ".join(named_code([*plan.agents, *plan.environments])))
    if not code:
        return
    if not sys.stdin.isatty():
        raise ConfigError(f"{directory} would run or ask {code}: if you trust it, add --trust")
    if not click.confirm(f"{directory} will run or ask {code}. Do you trust it?", err=True):
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
