"""`glue-experiment`: run an experiment."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import nullcontext
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final, TextIO

import click
from click.core import ParameterSource

from experiment_runner.cli.backend import backend_options, check_backend
from experiment_runner.cli.grouped import GroupedCommand
from experiment_runner.cli.out import results_alone
from experiment_runner.cli.planning import (
    ask_for_trust,
    find_players,
    make_plan,
    names_of,
    own_directory,
    role_sweeps,
)
from experiment_runner.executors.settings import CHECKPOINT_EVERY, Backend, HubOptions, Placement, RunConfig
from experiment_runner.plan.limits import BUDGETS, COUNTS, PLAYERS
from experiment_runner.plan.metrics import MetricsPlan
from experiment_runner.plan.plan import Plan, RoleSweep, budget, describe
from experiment_runner.view.launch import check_view
from glue import __version__
from glue.cli.shared import (
    HUB_KEY_SETTINGS,
    KEY_SETTINGS,
    WAIT_VARIABLE,
    keys_option,
    legacy_port_option,
)
from glue.errors import ConfigError
from glue.hub.config import (
    DEFAULT_HUB,
    DEFAULT_SESSION,
    HUB_VARIABLE,
    SESSION_VARIABLE,
    LegacyPort,
    check_session,
    check_url,
)
from glue.plugins.naming import complete_names
from glue.wire.messages import Role

_GROUPS: Final = {
    "Episodes and their results": (
        "--any-reward",
        "--checkpoint-every",
        "--record",
        "--ask",
        "--metrics-every",
        "--view",
        "--dry-run",
        "--trust",
    ),
    "A cluster": ("--engine", "--address", "--sbatch"),
    "Players from outside": ("--bind", "--legacy-port", "--keys", "--insecure"),
    "A running hub": ("--hub", "--session", "--key", "--hub-key", "--wait"),
}


@dataclass(frozen=True, slots=True)
class Options:
    """The command line; see the help of each option."""

    plan_file: Path | None
    episodes: int | None
    steps: int | None
    max_steps: int | None
    trials: int | None
    seed: int | None
    environment: str | None
    agent: str | None
    env_option: tuple[str, ...]
    agent_option: tuple[str, ...]
    in_process: bool
    inside: tuple[str, ...]
    workers: int | None
    engine: str
    address: str | None
    sbatch: tuple[str, ...]
    hub: str | None
    bind: tuple[str, ...]
    session: str
    key: str | None
    hub_key: str | None
    wait: float | None
    legacy_port: tuple[str, ...]
    keys: Path | None
    insecure: bool
    out: Path | None
    again: bool
    resume: Path | None
    trust: bool
    any_reward: bool
    checkpoint_every: int
    record: Path | None
    ask: tuple[str, ...]
    metrics_every: int | None
    view: bool
    dry_run: bool
    as_json: bool

    def counts(self) -> dict[str, Any]:
        """Return the numbers of a plan given on the command line."""
        counts = {name: getattr(self, name) for name in COUNTS}
        given = {name: value for name, value in counts.items() if value is not None}
        return given | ({} if self.metrics_every is None else {"metrics": MetricsPlan(self.metrics_every)})

    def roles(self) -> dict[str, tuple[RoleSweep, ...]]:
        """Return the agent and the environment in a plan's form."""
        return {
            "environments": role_sweeps(Role.ENVIRONMENT, self.environment, self.env_option),
            "agents": role_sweeps(Role.AGENT, self.agent, self.agent_option),
        }


class _Name(click.types.StringParamType):
    envvar_list_splitter = "\n"  # a path to a file may contain spaces


def _only_one(ctx: click.Context, option: click.Parameter, names: Sequence[str]) -> str | None:
    """Return the player's name, if one was given; by default, click takes the last of several."""
    if len(names) > 1:
        raise click.BadParameter(f"give one; a plan compares {' and '.join(names)} (--plan)", ctx, option)
    return names[0] if names else None


@click.command("glue-experiment", cls=GroupedCommand, groups=_GROUPS)
@click.option(
    "--env",
    "environment",
    metavar="NAME",
    multiple=True,
    type=_Name(),
    callback=_only_one,
    shell_complete=complete_names(Role.ENVIRONMENT),
    help="Environment; without it, one joins from outside.",
)
@click.option(
    "--agent",
    metavar="NAME",
    multiple=True,
    type=_Name(),
    callback=_only_one,
    shell_complete=complete_names(Role.AGENT),
    help="Agent; without it, one joins from outside.",
)
@click.option("--env-option", multiple=True, metavar="N=VALUE", help="See glue-env NAME --help.")
@click.option("--agent-option", multiple=True, metavar="N=VALUE", help="See glue-agent NAME --help.")
@click.option("--episodes", type=click.IntRange(1), metavar="N", help="Episodes of each trial.")
@click.option(
    "--steps",
    type=click.IntRange(1, COUNTS["steps"][-1]),
    metavar="N",
    help="Steps of each trial, in place of --episodes: its last episode is cut off.",
)
@click.option(
    "--max-steps",
    type=click.IntRange(0, COUNTS["max_steps"][-1]),
    metavar="N",
    help="Step limit of an episode. [default: 0, none]",
)
@click.option(
    "--trials", type=click.IntRange(1), metavar="N", help="Repetitions with other seeds. [default: 1]"
)
@click.option(
    "--seed", type=click.IntRange(0, COUNTS["seed"][-1]), metavar="N", help="Random seed. [default: 0]"
)
@click.option(
    "--plan",
    "plan_file",
    type=click.Path(path_type=Path, dir_okay=False),
    metavar="FILE",
    help="Plan in TOML; the five numbers above override it.",
)
@click.option("--in-process", is_flag=True, help="Players as objects, without a hub: fastest.")
@click.option(
    "--inside",
    multiple=True,
    type=click.Choice([*PLAYERS]),
    help="Run this player as an object in the hub's process; of both, it is --in-process.",
)
@backend_options(*Backend)
@click.option(
    "--sbatch",
    multiple=True,
    metavar="NAME=VALUE",
    help="Option for sbatch, such as time=2:00:00, with --engine slurm; repeat it for several.",
)
@click.option(
    "--hub",
    metavar="URL",
    envvar=HUB_VARIABLE,
    show_envvar=True,
    help="Use a running hub (glue-hub) instead of starting one.",
)
@click.option(
    "--bind",
    multiple=True,
    metavar="URL",
    help="Address at which players from outside join, or observers if none is expected; repeat it for "
    f"several. [default: {DEFAULT_HUB}, if a player is expected]",
)
@click.option(
    "--session",
    default=DEFAULT_SESSION,
    show_default=True,
    envvar=SESSION_VARIABLE,
    show_envvar=True,
    help="Session at the hub.",
)
@click.option("--key", **KEY_SETTINGS)
@click.option("--hub-key", **HUB_KEY_SETTINGS)
@click.option(
    "--wait",
    type=click.FloatRange(0),
    metavar="SECONDS",
    envvar=WAIT_VARIABLE,
    show_envvar=True,
    help="Timeout for the hub at --hub to answer. [default: wait forever]",
)
@legacy_port_option
@keys_option
@click.option(
    "--insecure", is_flag=True, help="Allow --bind without --keys to addresses that other machines can reach."
)
@click.option(
    "--out",
    type=click.Path(path_type=Path, file_okay=False),
    metavar="DIR",
    help="Directory of the run. [default: a new one in runs/]",
)
@click.option("--again", is_flag=True, help="Replace the run in --out and all of its results.")
@click.option(
    "--resume",
    type=click.Path(path_type=Path, file_okay=False),
    metavar="DIR",
    help="Continue a run; more --episodes, --steps or --trials extend it.",
)
@click.option(
    "--trust",
    is_flag=True,
    help="Do not ask before executing the files that the run of --resume names.",
)
@click.option(
    "--any-reward",
    is_flag=True,
    help="Accept rewards that are infinite or NaN; otherwise the first one ends the trial.",
)
@click.option(
    "--checkpoint-every",
    type=click.IntRange(0),
    metavar="N",
    default=CHECKPOINT_EVERY,
    show_default=True,
    help="Episodes between checkpoints of agent and environment; 0 for none.",
)
@click.option(
    "--record",
    type=click.Path(path_type=Path, dir_okay=False),
    metavar="FILE",
    help="Record every step of a single trial in this new file, for glue-replay.",
)
@click.option(
    "--ask",
    multiple=True,
    metavar="MESSAGE",
    help="Send the agent this message after each episode, and each step that --record records, and keep its "
    "answers for glue-view; repeat it for several.",
)
@click.option(
    "--metrics-every",
    type=click.IntRange(0),
    metavar="N",
    help="Record the agent's own numbers every N steps, 0 for after each episode.",
)
@click.option(
    "--view",
    is_flag=True,
    help="Show the run on a page in the browser, which stays until Ctrl-C; see glue-view.",
)
@click.option("--dry-run", is_flag=True, help="Show the trials and their seeds, without running them.")
@click.option("--json", "as_json", is_flag=True, help="Print JSON lines: each episode, then a summary.")
@click.version_option(__version__, prog_name="glue-experiment")
def experiment(**settings: Any) -> int:
    """Run an experiment: an agent in an environment, or everything in a plan.

    The same command with --out, or --resume, continues an interrupted run. The results are those of an
    uninterrupted one.

    \b
    Examples:
      glue-experiment --env mines --agent sarsa --episodes 2000
      glue-experiment --env mines --agent my.py:Mine --episodes 9 --in-process
      glue-experiment --plan sweep.toml --workers 4 --out runs/sweep
    """
    with results_alone() if settings["as_json"] else nullcontext() as results:
        return _experiment(Options(**settings), results)


def _experiment(options: Options, results: TextIO | None) -> int:
    """Carry out the command; `results` receives JSON lines, None for a table on standard output."""
    from experiment_runner.cli.arrays import carry_out_array
    from experiment_runner.cli.carrying_out import carry_out, carry_out_search, check_players, check_recording

    plan, given = _planned(options)
    inside = [*PLAYERS] if options.in_process else options.inside or plan.inside
    roles = frozenset(PLAYERS[player] for player in inside)
    placement = Placement(roles, _hub_options(options), any_reward=options.any_reward)
    backend, questions = Backend(options.engine), tuple(dict.fromkeys(options.ask))
    config = RunConfig(
        placement, options.checkpoint_every, backend, options.workers, options.address, questions
    )
    config = replace(config, metrics=plan.metrics)
    check_backend(config)
    check_players(config, plan)
    if options.record is not None:
        check_recording(config, plan)
    if options.dry_run:
        click.echo(describe(plan))
        return 0
    if options.sbatch and backend is not Backend.SLURM:
        raise ConfigError("--sbatch is for --engine slurm")
    if plan.tune is not None and (options.record or options.view or options.again or options.as_json):
        raise ConfigError("a plan with a search has no --record, --view, --again or --json")
    if backend is Backend.SLURM and (options.view or options.as_json):
        raise ConfigError("a job array runs later: it has no --view and no --json")
    if options.view:
        check_view()
    name = options.plan_file.stem if options.plan_file else names_of(plan)
    with own_directory(given, name) as directory:
        if plan.tune is not None:
            return carry_out_search(directory, plan, config)
        if backend is Backend.SLURM:
            return carry_out_array(directory, plan, config, options.sbatch, options.again)
        return carry_out(directory, plan, config, options.record, results, options.view, options.again)


def _planned(options: Options) -> tuple[Plan, Path | None]:
    """Return the plan that the options describe, and the directory of its run; None for a new one.

    Raises:
        ConfigError: the options contradict each other, or the plan is wrong.
        ExperimentError: there is no run to continue, or it cannot be read.
    """
    from experiment_runner.executors.opening import recorded_plan

    file, resume = options.plan_file, options.resume
    if file is not None and (
        options.agent or options.environment or options.agent_option or options.env_option
    ):
        raise ConfigError(
            f"{file} names the agents and environments: leave out --agent and --env, and write "
            "their options into the plan, below [agents.NAME] or [environments.NAME], instead of giving "
            "--agent-option and --env-option"
        )
    counts, roles = options.counts(), options.roles()
    if resume is None:
        if options.again and options.out is None:
            raise ConfigError("--again replaces the run in a directory: name it with --out")
        plan = make_plan(file, counts, roles)
        return plan, options.out
    others = any(roles.values()) or file or options.out or options.again
    if others or counts.keys() - {*BUDGETS, "trials"}:
        raise ConfigError(
            f"--resume continues the run in {resume} with its own plan: "
            "leave out --plan, --out, --again, and what changes a plan but more --episodes, --steps "
            "or --trials"
        )
    plan = replace(recorded_plan(resume), **budget(counts))
    if not options.dry_run:
        if not options.trust:
            ask_for_trust(resume, plan)
        find_players(plan)
    return plan, resume


def _hub_options(options: Options) -> HubOptions:
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
