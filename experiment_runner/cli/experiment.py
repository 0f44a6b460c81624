"""`glue-experiment`: run an experiment."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import nullcontext
from types import SimpleNamespace
from typing import Any, Final, TypeVar

import click

from experiment_runner.cli.options import backend_options, check_address
from experiment_runner.plan.limits import CHECKPOINT_EVERY, COUNTS, PLAYERS, Backend
from experiment_runner.view.launch import check_view
from glue import __version__
from glue.cli import shared
from glue.errors import ConfigError
from glue.hub.config import DEFAULT_HUB, DEFAULT_SESSION, HUB_VARIABLE, SESSION_VARIABLE
from glue.plugins.naming import NamingCommand, complete_names
from glue.wire.messages import Role

_Command = TypeVar("_Command", bound=Callable[..., Any])

_ALL: Final = f"{__name__}.all"
_GROUPS: Final = {
    "Episodes and their results": (
        "--any-reward",
        "--check-actions",
        "--checkpoint-every",
        "--record",
        "--ask",
        "--metrics-every",
        "--metric",
        "--view",
        "--dry-run",
        "--trust",
    ),
    "An environment that does not wait": ("--rate", "--late", "--delay"),
    "A cluster": ("--engine", "--address", "--sbatch"),
    "Players from outside": ("--bind", "--legacy-port", "--keys", "--insecure"),
    "A running hub": ("--hub", "--session", "--key", "--hub-key", "--wait"),
}


class _GroupedCommand(NamingCommand):
    """A command whose less common options are in `_GROUPS`."""

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the common options, and the groups or where to find them."""
        lines = {
            param.opts[-1]: line for param in self.get_params(ctx) if (line := param.get_help_record(ctx))
        }
        groups = {title: [lines.pop(flag) for flag in flags] for title, flags in _GROUPS.items()}
        with formatter.section("Options"):
            formatter.write_dl(list(lines.values()))
        if _ALL not in ctx.meta:
            formatter.write_paragraph()
            formatter.write_text(f"More by --help-all: {', '.join(title.lower() for title in groups)}.")
            return
        for title, group in groups.items():
            with formatter.section(title):
                formatter.write_dl(group)


def _show_all(ctx: click.Context, param: click.Parameter, value: bool) -> None:
    if value:
        ctx.meta[_ALL] = True
        click.echo(ctx.get_help())
        ctx.exit()


class _Name(click.types.StringParamType):
    envvar_list_splitter = "\n"  # a path to a file may contain spaces


def _only_one(ctx: click.Context, option: click.Parameter, names: Sequence[str]) -> str | None:
    """Return the player's name, if one was given; by default, click takes the last of several."""
    if len(names) > 1:
        raise click.BadParameter(f"give one; a plan compares {' and '.join(names)} (--plan)", ctx, option)
    return names[0] if names else None


def _player_option(flag: str, role: Role) -> Callable[[_Command], _Command]:
    return click.option(
        flag,
        str(role),
        metavar="NAME",
        multiple=True,
        type=_Name(),
        callback=_only_one,
        shell_complete=complete_names(role),
        help=f"{str(role).capitalize()}; without it, one joins from outside.",
    )


@click.command("glue-experiment", cls=_GroupedCommand)
@_player_option("--env", Role.ENVIRONMENT)
@_player_option("--agent", Role.AGENT)
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
    type=shared.FILE,
    metavar="FILE",
    help="Plan in TOML; numbers, pace, metrics override it.",
)
@shared.pace_options
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
@click.option("--key", **shared.KEY_SETTINGS)
@click.option("--hub-key", **shared.HUB_KEY_SETTINGS)
@click.option(
    "--wait",
    type=click.FloatRange(0),
    metavar="SECONDS",
    envvar=shared.WAIT_VARIABLE,
    show_envvar=True,
    help="Timeout for the hub at --hub to answer. [default: wait forever]",
)
@shared.legacy_port_option
@shared.keys_option
@click.option(
    "--insecure", is_flag=True, help="Allow --bind without --keys to addresses that other machines can reach."
)
@click.option(
    "--out", type=shared.DIRECTORY, metavar="DIR", help="Directory of the run. [default: a new one in runs/]"
)
@click.option("--again", is_flag=True, help="Replace the run in --out and all of its results.")
@click.option(
    "--resume",
    type=shared.DIRECTORY,
    metavar="DIR",
    help="Continue a run; more --episodes, --steps or --trials extend it.",
)
@click.option(
    "--trust", is_flag=True, help="Do not ask before running the code that the run of --resume names."
)
@click.option(
    "--any-reward",
    is_flag=True,
    help="Accept rewards that are infinite or NaN; otherwise the first one ends the trial.",
)
@click.option(
    "--check-actions",
    is_flag=True,
    help="End the trial at an action that the task spec or the observation's mask forbids.",
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
    type=shared.FILE,
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
    "--metric",
    multiple=True,
    metavar="EXTRA=HOW",
    help="Record a number that the environment attaches to its steps, such as mario.coins=last: an episode's "
    "first, last, sum, mean, min or max; repeat it for several.",
)
@click.option(
    "--view",
    is_flag=True,
    help="Show the run on a page in the browser, which stays until Ctrl-C; see glue-view.",
)
@click.option("--dry-run", is_flag=True, help="Show the trials and their seeds, without running them.")
@click.option("--json", "as_json", is_flag=True, help="Print JSON lines: each episode, then a summary.")
@click.version_option(__version__, prog_name="glue-experiment")
@click.option(
    "--help-all",
    is_flag=True,
    is_eager=True,
    expose_value=False,
    callback=_show_all,
    help="Show all options and exit.",
)
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
    # Slow to import.
    from experiment_runner.cli import run_plan
    from experiment_runner.cli.make_plan import hub_options, names_of, own_directory, planned
    from experiment_runner.executors.job import Placement, RunConfig
    from experiment_runner.plan.plan import describe

    options = SimpleNamespace(**settings)
    with run_plan.results_alone() if options.as_json else nullcontext() as results:
        plan, given = planned(options)
        inside = [*PLAYERS] if options.in_process else options.inside or plan.inside
        roles = frozenset(PLAYERS[player] for player in inside)
        checks = {"any_reward": options.any_reward, "check_actions": options.check_actions}
        placement = Placement(roles, hub_options(options), **checks)
        backend = Backend(options.engine)
        config = RunConfig(
            placement,
            options.checkpoint_every,
            backend,
            options.workers,
            options.address,
            questions=tuple(dict.fromkeys(options.ask)),
            metrics=plan.metrics,
            extras=plan.extras,
        )
        check_address(backend, options.address)
        run_plan.check_players(config, plan)
        if options.record is not None:
            run_plan.check_recording(config, plan)
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
                return run_plan.carry_out_search(directory, plan, config)
            if backend is Backend.SLURM:
                return run_plan.carry_out_array(directory, plan, config, options.sbatch, options.again)
            return run_plan.carry_out(
                directory, plan, config, options.record, results, options.view, options.again
            )
