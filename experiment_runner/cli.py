"""`glue-experiment`: run an experiment."""

from __future__ import annotations

import time
from contextlib import AbstractContextManager
from pathlib import Path

import click
import numpy as np

from experiment_runner.plan import Plan, RoleSweep, TrialSpec, check_options
from experiment_runner.players import HubOptions, in_process, over_hub
from experiment_runner.progress import JsonLines, Progress, Reporter
from experiment_runner.resume import create_run, remaining, resume_run
from experiment_runner.run import run_trials
from experiment_runner.store import Results, Store
from glue import __version__
from glue.commands import legacy_port_option, run
from glue.config import DEFAULT_HUB, DEFAULT_SESSION, LegacyPort, check_session, check_url
from glue.errors import ConfigError
from glue.experiment import Experiment
from glue.loading import find, names
from glue.messages import Role
from glue.options import parse_assignments

__all__ = ["experiment", "main"]

_LAST: int = 100


@click.command()
@click.option("--episodes", type=click.IntRange(1), required=True, help="Episodes to run.")
@click.option(
    "--max-steps",
    type=click.IntRange(0, 2**32 - 1),
    default=0,
    show_default=True,
    help="Step limit of an episode, as RL_episode's: RL_num_steps never exceeds it. 0 is none.",
)
@click.option(
    "--seed", type=click.IntRange(0, 2**63 - 1), default=0, show_default=True, help="Seed of all chance."
)
@click.option(
    "--env", "environment", metavar="NAME", help="Start this environment; without, one is waited for."
)
@click.option("--agent", metavar="NAME", help="Start this agent; without, one is waited for.")
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
    "--in-process", "one_process", is_flag=True, help="All three in this process, without a hub; the fastest."
)
@click.option("--hub", metavar="URL", help="Use a hub that runs already (glue-hub) instead of bringing one.")
@click.option(
    "--bind",
    multiple=True,
    metavar="URL",
    help="Address at which players from outside join; repeat it for several. "
    f"[default: {DEFAULT_HUB}, if any is expected]",
)
@click.option("--session", default=DEFAULT_SESSION, show_default=True, help="Session to hold at the hub.")
@legacy_port_option
@click.option("--insecure", is_flag=True, help="Allow --bind to addresses that other machines can reach.")
@click.option(
    "--out",
    type=click.Path(path_type=Path, file_okay=False),
    help="Directory of the results. [default: a new one in runs/]",
)
@click.option(
    "--checkpoint-every",
    type=click.IntRange(0),
    default=100,
    show_default=True,
    help="Episodes between checkpoints of what agent and environment know; 0 for none.",
)
@click.option(
    "--json",
    "as_json",
    is_flag=True,
    help="One object a line on standard output: each episode, then a summary.",
)
@click.version_option(__version__, prog_name="glue-experiment")
def experiment(
    episodes: int,
    max_steps: int,
    seed: int,
    environment: str | None,
    agent: str | None,
    env_option: tuple[str, ...],
    agent_option: tuple[str, ...],
    one_process: bool,
    hub: str | None,
    bind: tuple[str, ...],
    session: str,
    legacy_port: tuple[str, ...],
    insecure: bool,
    out: Path | None,
    checkpoint_every: int,
    as_json: bool,
) -> int:
    """Run an experiment: so many episodes of an agent in an environment.

    An agent or environment that is not named here is waited for, and the command that starts it in
    another terminal is shown.

    \b
    Examples:
      glue-experiment --episodes 5000
      glue-experiment --env mines --agent sarsa --episodes 2000
      glue-experiment --env mines --agent my_agent.py:MyAgent --episodes 100 --in-process
      glue-experiment --env mines --agent sarsa --agent-option step_size=0.2 --episodes 500 --json
      glue-experiment --env mines --episodes 100 --legacy-port 4096
    """
    plan = Plan(
        episodes=episodes,
        max_steps=max_steps,
        seed=seed,
        environments=_role(Role.ENVIRONMENT, environment, env_option),
        agents=_role(Role.AGENT, agent, agent_option),
    )
    plan = check_options(plan, lambda role, name: find(Role(role), name))
    options = _hub_options(hub, bind, session, insecure, legacy_port, one_process)
    reporter: Reporter = Progress()
    lines = JsonLines(reporter) if as_json else None

    def connect(spec: TrialSpec) -> AbstractContextManager[Experiment]:
        return in_process(spec) if one_process else over_hub(spec, options, reporter.say)

    began = time.monotonic()
    with _open(out or _new_directory(plan), plan) as store:
        failed = run_trials(
            store, remaining(store), connect, lines or reporter, checkpoint_every=checkpoint_every
        )
        reporter.close()
        seconds = time.monotonic() - began
        if lines is not None:
            lines.write(_summary(store, seconds))
        else:
            click.echo(_table(store, seconds))
    return 1 if failed else 0


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


def _hub_options(
    hub: str | None,
    bind: tuple[str, ...],
    session: str,
    insecure: bool,
    legacy_port: tuple[str, ...],
    one_process: bool,
) -> HubOptions:
    if hub is not None and bind:
        raise ConfigError("--bind is for a hub of the experiment's own; with --hub there is none")
    if legacy_port and (hub is not None or one_process):
        flag = "--in-process" if one_process else "--hub"
        raise ConfigError(f"--legacy-port is for a hub of the experiment's own; with {flag} there is none")
    for url in (*bind, *([hub] if hub else [])):
        check_url(url)
    check_session(session)
    legacy = tuple(LegacyPort.parse(text, session, insecure) for text in legacy_port)
    return HubOptions(hub, bind, session, insecure, legacy)


def _open(directory: Path, plan: Plan) -> Store:
    if (directory / "results.sqlite").exists():
        store, _ = resume_run(directory, plan)
        return store
    return create_run(directory, plan)


def _new_directory(plan: Plan) -> Path:
    parts = [time.strftime("%Y%m%d-%H%M%S")]
    parts += [sweeps[0].label for sweeps in (plan.agents, plan.environments) if sweeps]
    path = Path("runs") / "-".join(parts)
    number = 2
    while path.exists():
        path = Path("runs") / "-".join([*parts, str(number)])
        number += 1
    return path


def _table(results: Results, seconds: float) -> str:
    rows = [("trial", "episodes", "steps", "mean return", f"mean of last {_LAST}", "cut off", "void")]
    for record in results.trials():
        episodes = results.episodes(record.spec.id)
        returns = np.array([episode.episode_return for episode in episodes])
        rows.append(
            (
                record.spec.id,
                f"{record.done}/{record.spec.episodes}",
                f"{sum(episode.steps for episode in episodes):,}",
                f"{returns.mean():.2f}" if len(returns) else "-",
                f"{returns[-_LAST:].mean():.2f}" if len(returns) else "-",
                f"{sum(not episode.terminal for episode in episodes)}",
                f"{record.voids}",
            )
        )
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = [
        "  ".join(
            cell.ljust(width) if i == 0 else cell.rjust(width)
            for i, (cell, width) in enumerate(zip(row, widths, strict=True))
        )
        for row in rows
    ]
    return "\n".join([*lines, "", f"{seconds:.1f} s; results in {results.directory}"])


def _summary(results: Results, seconds: float) -> dict[str, object]:
    episodes = [episode for trial in results.trials() for episode in results.episodes(trial.spec.id)]
    last = [
        episode.episode_return
        for trial in results.trials()
        for episode in results.episodes(trial.spec.id)[-_LAST:]
    ]
    returns = [episode.episode_return for episode in episodes]
    return {
        "summary": True,
        "episodes": len(episodes),
        "steps": sum(episode.steps for episode in episodes),
        "mean_return": float(np.mean(returns)) if returns else None,
        f"mean_last_{_LAST}": float(np.mean(last)) if last else None,
        "cut_off": sum(not episode.terminal for episode in episodes),
        "voids": len(results.voids()),
        "failed_trials": sum(trial.failure is not None for trial in results.trials()),
        "seconds": seconds,
        "out": str(results.directory),
    }


def main() -> None:
    """Run `glue-experiment`."""
    run(experiment)


if __name__ == "__main__":
    main()
