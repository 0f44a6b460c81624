"""`glue-experiment`: run an experiment."""

from __future__ import annotations

import itertools
import sys
import time
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import click
from click.core import ParameterSource

from experiment_runner.plan import Plan, RoleSweep, absolute, check_options, class_files, describe
from experiment_runner.plan_file import load_plan
from glue import __version__
from glue.commands import HUB_VARIABLE, SESSION_VARIABLE, WAIT_VARIABLE, legacy_port_option, run
from glue.console import say
from glue.core.config import DEFAULT_HUB, DEFAULT_SESSION, LegacyPort, check_session, check_url
from glue.errors import ConfigError, ExperimentError
from glue.options import parse_assignments
from glue.players.loading import find, names
from glue.players.naming import NamingCommand, complete_names
from glue.protocol.messages import Role

if TYPE_CHECKING:
    from experiment_runner.executors.run import RunConfig
    from experiment_runner.players import Meeting

__all__ = ["experiment", "main"]

_MAX_STEPS: Final = 2**32 - 1
_CHECKPOINT_EVERY: Final = 100
_MAX_SEED: Final = 2**63 - 1


@click.command("glue-experiment", cls=NamingCommand)
@click.option(
    "--plan",
    "plan_file",
    type=click.Path(path_type=Path, dir_okay=False),
    metavar="FILE",
    help="Plan to run, in TOML: several agents, environments, options. The next four options change it.",
)
@click.option("--episodes", type=click.IntRange(1), help="Episodes of each trial.")
@click.option(
    "--max-steps",
    type=click.IntRange(0, _MAX_STEPS),
    help="Step limit of an episode, as RL_episode's: RL_num_steps never exceeds it. [default: 0, none]",
)
@click.option(
    "--trials",
    type=click.IntRange(1),
    help="Times to repeat everything, each with its own seed. [default: 1]",
)
@click.option("--seed", type=click.IntRange(0, _MAX_SEED), help="Random seed. [default: 0]")
@click.option(
    "--env",
    "environment",
    metavar="NAME",
    shell_complete=complete_names(Role.ENVIRONMENT),
    help="Start this environment; without, one is waited for.",
)
@click.option(
    "--agent",
    metavar="NAME",
    shell_complete=complete_names(Role.AGENT),
    help="Start this agent; without, one is waited for.",
)
@click.option(
    "--env-option", multiple=True, metavar="NAME=VALUE", help="Option of --env; see `glue-env NAME --help`."
)
@click.option(
    "--agent-option",
    multiple=True,
    metavar="NAME=VALUE",
    help="Option of --agent; see `glue-agent NAME --help`.",
)
@click.option(
    "--in-process",
    is_flag=True,
    help="Agent and environment in the process that runs the trial, without a hub; the fastest.",
)
@click.option(
    "--workers",
    type=click.IntRange(1),
    help="Trials at a time, each in a process of its own. [default: one after the other, in this process; "
    "with --engine ray, as many as the cluster has processors]",
)
@click.option(
    "--engine",
    type=click.Choice(["local", "ray"]),
    default="local",
    show_default=True,
    help="Where trials run: on this machine, or on a Ray cluster.",
)
@click.option(
    "--address",
    metavar="HOST:PORT",
    help="The Ray cluster. [default: the one that Ray finds, or else one on this machine]",
)
@click.option(
    "--hub",
    metavar="URL",
    envvar=HUB_VARIABLE,
    show_envvar=True,
    help="Use a hub that runs already (glue-hub) instead of starting one.",
)
@click.option(
    "--bind",
    multiple=True,
    metavar="URL",
    help="Address at which players from outside join; repeat it for several. "
    f"[default: {DEFAULT_HUB}, if any is expected]",
)
@click.option(
    "--session",
    default=DEFAULT_SESSION,
    show_default=True,
    envvar=SESSION_VARIABLE,
    show_envvar=True,
    help="Session to hold at the hub.",
)
@click.option(
    "--wait",
    type=click.FloatRange(0),
    metavar="SECONDS",
    envvar=WAIT_VARIABLE,
    show_envvar=True,
    help="Give up if no hub answers at --hub for so long. [default: wait forever]",
)
@legacy_port_option
@click.option("--insecure", is_flag=True, help="Allow --bind to addresses that other machines can reach.")
@click.option(
    "--out",
    type=click.Path(path_type=Path, file_okay=False),
    metavar="DIR",
    help="Directory of the results; if it holds a run of the same plan, that goes on. "
    "[default: a new one in runs/]",
)
@click.option(
    "--resume",
    type=click.Path(path_type=Path, file_okay=False),
    metavar="DIR",
    help="Go on with the run in this directory, whatever its plan is.",
)
@click.option(
    "--trust",
    is_flag=True,
    help="Run the code in the files that the run of --resume names, without asking.",
)
@click.option(
    "--any-reward",
    is_flag=True,
    help="Accept rewards that are infinite or not a number; without, the first one ends the trial.",
)
@click.option(
    "--checkpoint-every",
    type=click.IntRange(0),
    default=_CHECKPOINT_EVERY,
    show_default=True,
    help="Episodes between checkpoints of what agent and environment know; 0 for none.",
)
@click.option(
    "--record",
    type=click.Path(path_type=Path, dir_okay=False),
    metavar="FILE",
    help="Write every step to this new file, for glue-replay; of a single trial.",
)
@click.option("--dry-run", is_flag=True, help="Show what would run, and do nothing.")
@click.option(
    "--json",
    "as_json",
    is_flag=True,
    help="One object a line on standard output: each episode, then a summary.",
)
@click.version_option(__version__, prog_name="glue-experiment")
def experiment(
    plan_file: Path | None,
    episodes: int | None,
    max_steps: int | None,
    trials: int | None,
    seed: int | None,
    environment: str | None,
    agent: str | None,
    env_option: tuple[str, ...],
    agent_option: tuple[str, ...],
    in_process: bool,
    workers: int | None,
    engine: str,
    address: str | None,
    hub: str | None,
    bind: tuple[str, ...],
    session: str,
    wait: float | None,
    legacy_port: tuple[str, ...],
    insecure: bool,
    out: Path | None,
    resume: Path | None,
    trust: bool,
    any_reward: bool,
    checkpoint_every: int,
    record: Path | None,
    dry_run: bool,
    as_json: bool,
) -> int:
    """Run an experiment: so many episodes of an agent in an environment, or everything in a plan.

    An agent or environment that is not named here is waited for, and the command that starts it in
    another terminal is shown. A run that was interrupted, by whatever, goes on with the same command
    and --out, or with --resume, and ends as if nothing had happened.

    \b
    Examples:
      glue-experiment --episodes 5000
      glue-experiment --env mines --agent sarsa --episodes 2000
      glue-experiment --env mines --agent my_agent.py:MyAgent --episodes 100 --in-process
      glue-experiment --env mines --agent sarsa --agent-option step_size=0.2 --episodes 500 --json
      glue-experiment --env mines --episodes 100 --legacy-port 4096
      glue-experiment --env mario --agent sample --episodes 10 --record sample.traj
      glue-experiment --plan sweep.toml --workers 4 --out runs/sweep
      glue-experiment --resume runs/sweep --workers 4
    """
    from experiment_runner.executors.resume import recorded_plan
    from experiment_runner.executors.run import Place, RunConfig

    if _from_variable("hub") and (in_process or workers or engine == "ray" or bind or legacy_port):
        hub = None
    if _from_variable("session") and (in_process or workers or engine == "ray"):
        session = DEFAULT_SESSION
    counts = {"episodes": episodes, "max_steps": max_steps, "trials": trials, "seed": seed}
    if plan_file is not None and (agent or environment or agent_option or env_option):
        raise ConfigError(
            f"{plan_file} says which agents and environments there are: leave out --agent and --env, and "
            "write what --agent-option and --env-option would say into the plan, below [agents.NAME] or "
            "[environments.NAME]"
        )
    given = {name: value for name, value in counts.items() if value is not None}
    roles = {
        "environments": _role(Role.ENVIRONMENT, environment, env_option),
        "agents": _role(Role.AGENT, agent, agent_option),
    }
    if resume is not None:
        if given or any(roles.values()) or plan_file or out:
            raise ConfigError(
                f"--resume goes on with the plan and the results in {resume}: "
                "leave out --plan, --out, and what the plan says"
            )
        plan, directory = recorded_plan(resume), resume
        if not (trust or dry_run):
            _ask_for_trust(resume, plan)
    else:
        try:
            plan = _plan(plan_file, given, roles)
        except ExperimentError as error:  # a plan is what the command asks for
            raise ConfigError(str(error)) from error
        directory = out or _new_directory(plan_file.stem if plan_file else _labels(plan))
    meeting = _meeting(in_process, hub, bind, session, wait if hub else None, legacy_port, insecure)
    meeting = replace(meeting, any_reward=any_reward)
    config = RunConfig(meeting, checkpoint_every, Place(engine), workers, address)
    config.check(plan, recording=record is not None)
    if dry_run:
        click.echo(describe(plan))
        return 0
    return _run(directory, plan, config, record, as_json)


def _from_variable(option: str) -> bool:
    """Return whether an option is given by an environment variable: one on the command line overrides it."""
    return click.get_current_context().get_parameter_source(option) is ParameterSource.ENVIRONMENT


def _role(role: Role, name: str | None, assignments: tuple[str, ...]) -> tuple[RoleSweep, ...]:
    flag = "env" if role is Role.ENVIRONMENT else "agent"
    if name is None:
        if assignments:
            raise ConfigError(
                f"--{flag}-option needs --{flag} NAME (there are {', '.join(names(role))}); an {role} that "
                f"connects from outside has its options on its own command line"
            )
        return ()
    return (RoleSweep(name, parse_assignments(find(role, name), assignments)),)


def _plan(plan_file: Path | None, counts: dict[str, Any], roles: dict[str, Any]) -> Plan:
    if plan_file is None:
        if "episodes" not in counts:
            raise ConfigError("say how many --episodes to run, or give a --plan or a run to --resume")
        plan = absolute(Plan(**counts, **roles), Path.cwd())
    else:
        plan = absolute(replace(load_plan(plan_file), **counts), plan_file.parent)
    plan = check_options(plan, lambda role, name: find(Role(role), name))
    plan.expand()  # is refused here, before anything is made, if it has a trial twice
    return plan


def _ask_for_trust(directory: Path, plan: Plan) -> None:
    """Make sure that somebody wants the code run which a run directory names: it may be another's."""
    files = ", ".join(class_files([*plan.agents, *plan.environments]))
    if not files:
        return
    if not sys.stdin.isatty():
        raise ConfigError(f"{directory} names code that would be run, {files}: if you trust it, say --trust")
    click.confirm(f"{directory} names code that will be run: {files}. Do you trust it?", abort=True, err=True)


def _meeting(
    in_process: bool,
    hub: str | None,
    bind: tuple[str, ...],
    session: str,
    wait: float | None,
    legacy_port: tuple[str, ...],
    insecure: bool,
) -> Meeting:
    from experiment_runner.players import HubOptions, Meeting

    if hub is not None and (bind or legacy_port):
        flag = "--bind" if bind else "--legacy-port"
        raise ConfigError(f"{flag} is for a hub of the experiment's own; with --hub there is none")
    for url in (*bind, *([hub] if hub else [])):
        check_url(url)
    check_session(session)
    # Each is opened once, also if it is given twice.
    legacy = dict.fromkeys(LegacyPort.parse(text, session, insecure) for text in legacy_port)
    bind = tuple(dict.fromkeys(bind))
    return Meeting(in_process, HubOptions(hub, bind, session, wait, insecure, tuple(legacy)))


def _labels(plan: Plan) -> str:
    return "-".join(sweeps[0].label for sweeps in (plan.agents, plan.environments) if sweeps) or "remote"


def _new_directory(name: str) -> Path:
    first = Path("runs") / f"{time.strftime('%Y%m%d-%H%M%S')}-{name}"
    candidates = itertools.chain([first], (Path(f"{first}-{number}") for number in itertools.count(2)))
    return next(path for path in candidates if not path.exists())


def _run(directory: Path, plan: Plan, config: RunConfig, record: Path | None, as_json: bool) -> int:
    from experiment_runner.executors.resume import open_run
    from experiment_runner.executors.run import run_trials
    from experiment_runner.players import listening
    from experiment_runner.recording import recorded
    from experiment_runner.report.progress import JsonLines, Progress
    from experiment_runner.report.tables import summarize, tabulate, terminal_width

    progress = Progress()
    lines = JsonLines(progress) if as_json else None
    began = time.monotonic()
    with ExitStack() as stack:
        # Before anything is written: an address may be in use.
        addresses = stack.enter_context(ExitStack())
        meeting = addresses.enter_context(listening(plan, config.meeting))
        recording = stack.enter_context(recorded(record))
        store = stack.enter_context(open_run(directory, plan, say=progress.say))
        failed = run_trials(store, replace(config, meeting=meeting), lines or progress, recording)
        addresses.close()  # nobody would serve who joins from here on
        seconds = time.monotonic() - began
        if lines is not None:
            lines.write(summarize(store, seconds))
        else:
            click.echo(tabulate(store, seconds, terminal_width()))
    if record is not None and not record.exists():
        say(f"no episode was begun, so there is no {record}")
    return 1 if failed else 0


def main() -> None:
    """Run `glue-experiment`."""
    run(experiment)


if __name__ == "__main__":
    main()
