"""Run a plan for a person or a script: with progress, a recording, a page, and a table at the end.

Or submit it as a job array of SLURM, and gather the results.
"""

from __future__ import annotations

import os
import shlex
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, redirect_stdout, suppress
from dataclasses import replace
from pathlib import Path
from typing import Final, TextIO

import click

from experiment_runner.cli.options import naming_out
from experiment_runner.executors.job import HubOptions, RunConfig
from experiment_runner.executors.opening import FINISH, kept_if_begun, open_run, recorded_plan, remaining
from experiment_runner.executors.recording import recorded
from experiment_runner.executors.run import run_trials
from experiment_runner.plan.limits import PLAYERS, REMOTE
from experiment_runner.plan.metrics import extra_of
from experiment_runner.plan.plan import Plan
from experiment_runner.plan.user_files import named_code
from experiment_runner.report.overview import date
from experiment_runner.report.progress import JsonLines, Progress
from experiment_runner.report.tables import counted, summarize, tabulate, terminal_width
from experiment_runner.slurm import array
from experiment_runner.slurm.array import divide, gather
from experiment_runner.store.database import holds_run, reported
from experiment_runner.store.layout import PARTS, clear, replace_flushed
from experiment_runner.store.records import TUNED, UNMETERED, UNSEEDED
from experiment_runner.store.results import Results
from experiment_runner.store.store import Store
from experiment_runner.view.launch import viewed
from glue.cli.screen import has_color
from glue.console import one_line, say
from glue.errors import ConfigError, ExperimentError
from glue.files import read_text
from glue.hub.config import DEFAULT_SESSION
from glue.plugins.loading import find, without_seed
from glue.wire.messages import Role

_PROGRAM: Final = (sys.executable, "-P", "-m", "glue_rl")
_SCRIPT: Final = "array.sh"
_JOB: Final = "job"
"""Files in the folder of the parts: the script of the array, and its job number."""


@contextmanager
def results_alone() -> Iterator[TextIO]:
    """Yield standard output for results alone: whatever else is printed there goes to standard error.

    That is also what players print, in this process, in compiled code or in processes of their own.
    """
    results = sys.stdout
    with ExitStack() as stack:
        with suppress(OSError):  # a test's buffer, which has no descriptor
            number = results.fileno()
            results.flush()
            ours = os.dup(number)
            results = stack.enter_context(open(ours, "w", encoding="utf-8"))
            os.dup2(sys.stderr.fileno(), number)
            stack.callback(os.dup2, ours, number)
        stack.enter_context(redirect_stdout(sys.stderr))
        yield results


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
            _finish(store, plan, progress.say)
        addresses.close()  # a player that joins from now on would not be served
        if not holds_run(directory):
            raise ExperimentError(f"{directory} was moved or removed during the run, and its results with it")
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
    from experiment_runner.executors.search import tune  # slow to import

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
    """Show, and record once in the run, which of the user's agents and environments take no seed.

    Raises:
        ConfigError: a class does not exist, or cannot be imported.
    """
    for role, sweeps in ((Role.ENVIRONMENT, plan.environments), (Role.AGENT, plan.agents)):
        for sweep in sweeps:
            if (line := without_seed(role, sweep.label, find(role, sweep.name))) is not None:
                say(line)
                store.record_once(UNSEEDED, line)


def _finish(store: Store, plan: Plan, say: Callable[[str], None]) -> None:
    """Record that all trials are finished, and say of which extras none has had a value.

    A trial itself says nothing of a name with a dot, which may be of an environment with another label, where
    there are labels.
    """
    store.record_event(FINISH, "all trials are finished")
    labels = sorted({trial.spec.environment_label for trial in store.trials()})
    found = {*store.metric_names()}
    for key in plan.extras:
        names = {label: extra_of(key, label) for label in labels}
        unsaid = all("." in name and label != REMOTE for label, name in names.items())
        if unsaid and found.isdisjoint(f"{label}.{name}" for label, name in names.items()):
            why = f"no such extra came from {', '.join(labels)}"
            line = f"metric {key} never had a value: {why}"
            say(line)
            store.record_once(UNMETERED, line)


def _since(store: Store) -> str:
    """Return the date at which a run was finished, as in ` on 2026-11-22 10:30 UTC`, if it was recorded."""
    times = [event.time for event in store.events() if event.kind == FINISH]
    return f" on {date(max(times))}" if times else ""


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
    if config.placement.check_actions:
        command.append("--check-actions")
    command += [f"--ask={question}" for question in config.questions]
    if named_code([role for trial in store.trials() for role in (trial.spec.agent, trial.spec.environment)]):
        command.append("--trust")
    return command


def check_players(config: RunConfig, plan: Plan) -> None:
    """Check that the players of a plan can be connected.

    Raises:
        ConfigError: they cannot.
    """
    inside = config.placement.inside
    if plan.pace and config.placement.hub.hub is not None:
        raise ConfigError("a running hub has its own pace: give --rate, --late and --delay to glue-hub")
    if plan.rate and inside == {Role.AGENT}:
        raise ConfigError(
            "an agent in the process of the hub would keep the environment waiting: leave out --inside agent"
        )
    if (
        inside
        and not (config.parallel or config.placement.in_process)
        and config.placement.hub.hub is not None
    ):
        raise ConfigError("players run inside the process of a hub of our own: leave out --hub, or --inside")
    for flag, sweeps in (("agent", plan.agents), ("env", plan.environments)):
        if PLAYERS[flag] in inside and not sweeps and not config.placement.in_process:
            raise ConfigError(f"--{flag} NAME is missing: only a named player runs inside")
    if config.placement.check_actions and not plan.environments:
        raise ConfigError("--check-actions needs --env NAME; glue-env has the option for one from outside")
    if config.placement.check_actions and plan.pace:
        raise ConfigError(
            "with a rate or a delay, an action is carried out in another state than it was chosen in, and "
            "may be illegal there: leave out --check-actions"
        )
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


def carry_out_array(
    directory: Path, plan: Plan, config: RunConfig, sbatch: Sequence[str], again: bool
) -> int:
    """Submit the unfinished trials of a plan as a job array, and a job that gathers their results.

    Args:
        directory: of the run, new or existing.
        plan: of the run.
        config: how to execute the plan, checked for it.
        sbatch: options for sbatch, as NAME or NAME=VALUE.
        again: replace a run in the directory.

    Returns:
        The exit code.

    Raises:
        ConfigError: SLURM is not installed, or an option is malformed.
        ExperimentError: the run has tasks in the queue, or SLURM refuses the job.
    """
    if not array.can_submit():
        raise ConfigError("--engine slurm submits with sbatch, which is not here: use a login node of SLURM")
    array.check_options(sbatch)
    array.check_folder(directory.absolute())
    if again:
        with naming_out(""):
            clear(directory)
    elif holds_run(directory):
        _gather(directory)
    with naming_out(", or replace the results with --again"):
        store = open_run(directory, plan, say=say)
    parts = directory.absolute() / PARTS
    with store:
        if not (left := len(remaining(store))):
            say(f"{directory} is already finished: nothing was submitted")
            return 0
        note_players_without_seed(store, plan, say)
        tasks = divide(store, array.MAX_TASKS)
        options = [*resume_options(store, config), f"--checkpoint-every={config.checkpoint_every}"]
        if config.placement.in_process:
            options.append("--in-process")
        command = [*_PROGRAM, "experiment", *options, "--resume"]
        replace_flushed(parts / _SCRIPT, array.array_script(parts, command, tasks, config.workers, sbatch))
        job = array.submit([str(parts / _SCRIPT)])
        replace_flushed(parts / _JOB, job)
    what = f"{counted(left, 'trial')} in {counted(tasks, 'task')}"
    say(f"submitted job {job}: {what}, with output in {parts}")
    gathering = [*_PROGRAM, "results", "gather", str(directory.absolute())]
    try:
        array.submit(array.gathering_job(job, parts, gathering, sbatch))
    except ExperimentError as error:
        raise ExperimentError(f"{error}; when job {job} is over: glue-results gather {directory}") from error
    say(f"when the last task is over, the results are in {directory}")
    return 0


def gather_run(directory: Path) -> None:
    """Move the results of the tasks of a job array to their run, and show how much is finished.

    Raises:
        ExperimentError: there is no run, or it has tasks that wait or run.
    """
    unfinished, trials = _gather(directory)
    say(f"{directory}: {trials - unfinished} of {trials} trials are finished")
    if unfinished:
        say(f"continue with: glue-experiment --resume {directory} --engine slurm")


def _gather(directory: Path) -> tuple[int, int]:
    """Gather the results; return the number of unfinished trials, and of all trials."""
    job = directory / PARTS / _JOB
    with reported(f"cannot read {job}"):
        number = read_text(job).strip() if job.exists() else ""
    if number and array.is_queued(number):
        raise ExperimentError(
            f"job {number} has tasks of {directory} that wait or run: see squeue --jobs={number}, "
            f"and end it with scancel {number} if it is not wanted"
        )
    with Store.open(directory) as store:
        gathered, left = gather(store), len(remaining(store))
        if gathered and not left:
            _finish(store, recorded_plan(directory), say)
        return left, len(store.trials())
