"""`glue-experiment`: run an experiment."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Final

import click
from click.core import ParameterSource

from experiment_runner.commands.planning import ask_for_trust, make_plan, new_directory, role_sweeps
from experiment_runner.executors.settings import CHECKPOINT_EVERY, Place
from experiment_runner.plan import describe
from experiment_runner.view.starting import check_view
from glue import __version__
from glue.commands import (
    HUB_KEY_SETTINGS,
    KEY_SETTINGS,
    WAIT_VARIABLE,
    keys_option,
    legacy_port_option,
    run,
)
from glue.core.config import (
    DEFAULT_HUB,
    DEFAULT_SESSION,
    HUB_VARIABLE,
    SESSION_VARIABLE,
    LegacyPort,
    check_session,
    check_url,
)
from glue.errors import ConfigError
from glue.players.naming import NamingCommand, complete_names
from glue.protocol.messages import Role

if TYPE_CHECKING:
    from experiment_runner.players import HubOptions

__all__ = ["experiment", "main"]

_MAX_STEPS: Final = 2**32 - 1
_MAX_SEED: Final = 2**63 - 1


@click.command("glue-experiment", cls=NamingCommand)
@click.option(
    "--plan",
    "plan_file",
    type=click.Path(path_type=Path, dir_okay=False),
    metavar="FILE",
    help="Plan to run, in TOML: several agents, environments, options. The next four options override it.",
)
@click.option("--episodes", type=click.IntRange(1), help="Episodes of each trial.")
@click.option(
    "--max-steps",
    type=click.IntRange(0, _MAX_STEPS),
    help="Step limit of an episode (truncation), as in RL_episode: RL_num_steps never exceeds it. "
    "[default: 0, none]",
)
@click.option(
    "--trials",
    type=click.IntRange(1),
    help="Repetitions of the experiment, each with its own seed. [default: 1]",
)
@click.option("--seed", type=click.IntRange(0, _MAX_SEED), help="Random seed. [default: 0]")
@click.option(
    "--env",
    "environment",
    metavar="NAME",
    shell_complete=complete_names(Role.ENVIRONMENT),
    help="Environment to start; if omitted, the experiment waits for one to join.",
)
@click.option(
    "--agent",
    metavar="NAME",
    shell_complete=complete_names(Role.AGENT),
    help="Agent to start; if omitted, the experiment waits for one to join.",
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
    help="Run agent and environment in the process of the trial, without a hub; this is fastest.",
)
@click.option(
    "--workers",
    type=click.IntRange(1),
    help="Maximum number of concurrent trials, each in its own process. [default: one after the other in "
    "this process; with --engine ray, the cluster's number of processors]",
)
@click.option(
    "--engine",
    type=click.Choice([place.value for place in Place]),
    default=Place.LOCAL.value,
    show_default=True,
    help="Where trials run: on this machine, or on a Ray cluster.",
)
@click.option(
    "--address",
    metavar="HOST:PORT",
    help="Ray cluster. [default: the one that Ray finds, or else one on this machine]",
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
    help="Address at which players from outside join; repeat it for several. "
    f"[default: {DEFAULT_HUB}, if any is expected]",
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
    help="Directory of the results; if it contains a run of the same plan, that run continues. "
    "[default: a new one in runs/]",
)
@click.option(
    "--resume",
    type=click.Path(path_type=Path, file_okay=False),
    metavar="DIR",
    help="Continue the run in this directory.",
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
    "--view",
    is_flag=True,
    help="Show the run on a page in the browser, which stays until Ctrl-C; see glue-view.",
)
@click.option("--dry-run", is_flag=True, help="Show what would be run, without running it.")
@click.option(
    "--json",
    "as_json",
    is_flag=True,
    help="Print a JSON object per line on standard output: each episode, then a summary.",
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
    key: str | None,
    hub_key: str | None,
    wait: float | None,
    legacy_port: tuple[str, ...],
    keys: Path | None,
    insecure: bool,
    out: Path | None,
    resume: Path | None,
    trust: bool,
    any_reward: bool,
    checkpoint_every: int,
    record: Path | None,
    ask: tuple[str, ...],
    view: bool,
    dry_run: bool,
    as_json: bool,
) -> int:
    """Run an experiment: episodes of an agent in an environment, or everything in a plan.

    If no agent or environment is named, the experiment waits for one to join, and shows the command that
    starts it in another terminal. An interrupted run is continued by the same command with --out, or by
    --resume, and gives the same results as one that was not interrupted.

    \b
    Examples:
      glue-experiment --episodes 5000
      glue-experiment --env mines --agent sarsa --episodes 2000
      glue-experiment --env mines --agent my_agent.py:MyAgent --episodes 100 --in-process
      glue-experiment --env mines --agent sarsa --agent-option step_size=0.2 --episodes 500 --json
      glue-experiment --env mines --episodes 100 --legacy-port 4096
      glue-experiment --env mines --episodes 100 --bind tcp://*:4097 --keys keys
      glue-experiment --env mario --agent sample --episodes 10 --record sample.traj
      glue-experiment --env mario --agent best --episodes 500 --ask best --ask epsilon --view
      glue-experiment --plan sweep.toml --workers 4 --out runs/sweep
      glue-experiment --resume runs/sweep --workers 4
    """
    from experiment_runner.commands.carrying_out import carry_out
    from experiment_runner.executors.resume import recorded_plan
    from experiment_runner.executors.run import RunConfig
    from experiment_runner.players import HubOptions, Meeting

    if _from_variable("hub") and (
        in_process or workers or engine == Place.RAY or bind or legacy_port or keys
    ):
        hub = None
    if _from_variable("session") and (in_process or workers or engine == Place.RAY):
        session = DEFAULT_SESSION
    counts = {"episodes": episodes, "max_steps": max_steps, "trials": trials, "seed": seed}
    if plan_file is not None and (agent or environment or agent_option or env_option):
        raise ConfigError(
            f"{plan_file} names the agents and environments: leave out --agent and --env, and write "
            "their options into the plan, below [agents.NAME] or [environments.NAME], instead of giving "
            "--agent-option and --env-option"
        )
    given = {name: value for name, value in counts.items() if value is not None}
    roles = {
        "environments": role_sweeps(Role.ENVIRONMENT, environment, env_option),
        "agents": role_sweeps(Role.AGENT, agent, agent_option),
    }
    if resume is not None:
        if given or any(roles.values()) or plan_file or out:
            raise ConfigError(
                f"--resume continues the run in {resume} with its own plan: "
                "leave out --plan, --out, and all options that change a plan"
            )
        plan, directory = recorded_plan(resume), resume
        if not (trust or dry_run):
            ask_for_trust(resume, plan)
    else:
        plan = make_plan(plan_file, given, roles)
        directory = out or new_directory(plan, plan_file)
    options = HubOptions(
        hub,
        tuple(dict.fromkeys(bind)),
        check_session(session),
        wait if hub else None,
        insecure,
        # Each is opened once, even if it is given twice.
        tuple(dict.fromkeys(LegacyPort.parse(text, session, insecure) for text in legacy_port)),
        key if hub or not _from_variable("key") else None,
        hub_key if hub or not _from_variable("hub_key") else None,
        keys,
    )
    _check(options)
    meeting = Meeting(in_process, options, any_reward=any_reward)
    config = RunConfig(meeting, checkpoint_every, Place(engine), workers, address, tuple(dict.fromkeys(ask)))
    config.check(plan, recording=record is not None)
    if dry_run:
        click.echo(describe(plan))
        return 0
    if view:
        check_view()
    return carry_out(directory, plan, config, record, as_json, view)


def _from_variable(option: str) -> bool:
    """Return whether an option is set by an environment variable rather than on the command line."""
    return click.get_current_context().get_parameter_source(option) is ParameterSource.ENVIRONMENT


def _check(options: HubOptions) -> None:
    """Refuse options that contradict each other, and addresses that are malformed."""
    ours = {"--bind": options.bind, "--legacy-port": options.legacy, "--keys": options.keys}
    theirs = {"--key": options.key, "--hub-key": options.hub_key}
    flag = next((flag for flag, value in (theirs if options.hub is None else ours).items() if value), None)
    if flag is not None and options.hub is None:
        raise ConfigError(f"{flag} is for a running hub: name it with --hub")
    if flag is not None:
        raise ConfigError(
            f"{flag} is for a hub that the experiment starts, and --hub names a running one: leave one out"
        )
    for url in (*options.bind, *([options.hub] if options.hub else [])):
        check_url(url)


def main() -> None:
    """Run `glue-experiment`."""
    run(experiment)


if __name__ == "__main__":
    main()
