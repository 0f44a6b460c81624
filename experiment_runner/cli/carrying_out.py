"""Carry out a plan for a person or a script: with progress, a recording, a page, and a table at the end."""

from __future__ import annotations

import shlex
import sys
import time
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import TextIO

import click

from experiment_runner.cli.out import naming_out
from experiment_runner.cli.planning import without_seed
from experiment_runner.executors.opening import (
    FINISH,
    finished_at,
    kept_if_begun,
    open_run,
    remaining,
)
from experiment_runner.executors.recording import recorded
from experiment_runner.executors.run import run_trials
from experiment_runner.executors.settings import HubOptions, RunConfig
from experiment_runner.plan.limits import PLAYERS
from experiment_runner.plan.plan import Plan, class_files
from experiment_runner.report.progress import JsonLines, Progress
from experiment_runner.report.tables import summarize, tabulate, terminal_width
from experiment_runner.store.layout import clear
from experiment_runner.store.records import TUNED, UNSEEDED
from experiment_runner.store.results import Results
from experiment_runner.store.store import Store
from experiment_runner.view.launch import viewed
from glue.cli.screen import has_color
from glue.console import one_line, say
from glue.errors import ConfigError
from glue.hub.config import DEFAULT_SESSION


def carry_out(
    directory: Path,
    plan: Plan,
    config: RunConfig,
    record: Path | None,
    results: TextIO | None,
    view: bool,
    again: bool = False,
) -> int:
    """Run the unfinished trials of a plan; return the exit code: 1 if a trial has failed.

    Args:
        directory: of the run, new or existing.
        plan: of the run.
        config: how to execute the plan, checked for it.
        record: file of the recording; None for none.
        results: receives JSON lines; None for a table on standard output.
        view: show the run on a page, which stays until Ctrl-C.
        again: replace a run in the directory.
    """
    color = has_color(sys.stderr)
    progress = Progress(color=color) if results is None else JsonLines(results, color=color)
    began = time.monotonic()

    def kept() -> None:
        say(f"nothing is lost: continue with --resume {directory}")

    with kept_if_begun(directory, kept), ExitStack() as stack:
        addresses = stack.enter_context(ExitStack())
        if not config.placement.in_process:
            from experiment_runner.executors.over_hub import listening  # slow to import

            # Before anything is written, because an address may be in use.
            placement = addresses.enter_context(listening(plan, config.placement, progress.say))
            config = replace(config, placement=placement)
        # A recording may be one of the run's own files: then the run's folder must exist first.
        inside = record is not None and record.absolute().parent == directory.absolute()
        recording = None if inside else stack.enter_context(recorded(record))
        with naming_out(", or replace the results with --again"):
            if again:
                clear(directory)
            store = stack.enter_context(open_run(directory, plan, say=progress.say))
        if inside:
            recording = stack.enter_context(recorded(record))
        wait = stack.enter_context(viewed(directory, progress.say)) if view else None
        left = remaining(store)
        if left:
            note_players_without_seed(store, plan, progress.say)
        else:
            progress.say(f"{directory} was already finished{_since(store)}: nothing was run")
        failed = run_trials(store, config, progress, recording, again=resume_command(store, config))
        if left and not remaining(store):
            store.record_event(FINISH, "all trials are finished")
        addresses.close()  # a player that joins from now on would not be served
        seconds = time.monotonic() - began
        if isinstance(progress, JsonLines):
            progress.write(summarize(store, seconds))
        else:
            click.echo(tabulate(store, seconds, terminal_width()))
        if wait is not None:
            store.close()
            wait()
    if record is not None and not record.exists():
        say(f"no episode was started, so {record} was not written")
    return 1 if failed else 0


def carry_out_search(directory: Path, plan: Plan, config: RunConfig) -> int:
    """Search for the options of a plan's agents, and run the chosen ones; return the exit code."""
    from experiment_runner.executors.search import tune

    progress = Progress(color=has_color(sys.stderr))
    again = "the same command, with --out " + shlex.quote(str(directory))
    began = time.monotonic()
    with naming_out():
        result, failed = tune(directory, plan, config, progress, again)
    with Results.open(result) as results:
        click.echo(tabulate(results, time.monotonic() - began, terminal_width()))
        for event in results.events():
            if event.kind == TUNED:
                click.echo(one_line(event.text))
    return 1 if failed else 0


def note_players_without_seed(store: Store, plan: Plan, say: Callable[[str], None]) -> None:
    """Show, and record once in the run, which players of a plan take no seed."""
    known = {event.text for event in store.events() if event.kind == UNSEEDED}
    for line in without_seed(plan):
        say(line)
        if line not in known:
            store.record_event(UNSEEDED, line)


def _since(store: Store) -> str:
    """Return the date at which a run was finished, as in ` on 2026-11-22 10:30 UTC`, if it was recorded."""
    from experiment_runner.report.overview import date

    time = finished_at(store)
    return "" if time is None else f" on {date(time)}"


def resume_command(store: Store, config: RunConfig) -> str:
    """Return the command that continues a run, with the options that the run directory does not hold."""
    return shlex.join(["glue-experiment", "--resume", str(store.directory), *resume_options(store, config)])


def resume_options(store: Store, config: RunConfig) -> list[str]:
    """Return the options that a run needs to continue, but does not hold in its directory."""
    hub = config.placement.hub
    command = [f"--bind={url}" for url in hub.bind]
    command += [f"--legacy-port={port.host}:{port.port or '*'}={port.session}" for port in hub.legacy]
    for option, value in (("hub", hub.hub), ("key", hub.key), ("hub-key", hub.hub_key), ("keys", hub.keys)):
        if value is not None:
            command.append(f"--{option}={value}")
    if hub.session != DEFAULT_SESSION:
        command.append(f"--session={hub.session}")
    if hub.insecure:
        command.append("--insecure")
    if not config.placement.in_process:
        command += [f"--inside={flag}" for flag, role in PLAYERS.items() if role in config.placement.inside]
    if config.placement.any_reward:
        command.append("--any-reward")
    command += [f"--ask={question}" for question in config.questions]
    if class_files([role for trial in store.trials() for role in (trial.spec.agent, trial.spec.environment)]):
        command.append("--trust")
    return command


def check_players(config: RunConfig, plan: Plan) -> None:
    """Check that the players of a plan can be connected.

    Raises:
        ConfigError: they cannot.
    """
    inside = config.placement.inside
    if (
        inside
        and not (config.parallel or config.placement.in_process)
        and config.placement.hub.hub is not None
    ):
        raise ConfigError("players run inside the process of a hub of our own: leave out --hub, or --inside")
    for flag, sweeps in (("agent", plan.agents), ("env", plan.environments)):
        if PLAYERS[flag] in inside and not sweeps and not config.placement.in_process:
            raise ConfigError(f"--{flag} NAME is missing: only a named player runs inside")
    if not (config.parallel or config.placement.in_process):
        return
    if config.placement.hub != HubOptions():
        why = "every worker starts its own hub" if config.parallel else "with --in-process there is no hub"
        raise ConfigError(f"{why}: leave out --hub, --bind, --session and --legacy-port")
    for role, sweeps in (("agent", plan.agents), ("env", plan.environments)):
        if not sweeps:
            raise ConfigError(
                f"--{role} NAME is missing: a player can join from outside only where trials run "
                "one after the other, over a hub"
            )


def check_recording(config: RunConfig, plan: Plan) -> None:
    """Check that a plan can be recorded.

    Raises:
        ConfigError: it has several trials, or they run in other processes.
    """
    if config.parallel:
        raise ConfigError("--record needs a trial in this process: leave out --workers and --engine")
    if (count := len(plan.expand())) > 1:
        raise ConfigError(f"--record needs a single trial, and the plan has {count}: make a plan of one")
