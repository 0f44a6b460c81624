"""Carry out a plan as a job array of SLURM: divide its trials, submit them, and gather their results."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

from experiment_runner.cli.carrying_out import note_players_without_seed, resume_options
from experiment_runner.cli.out import naming_out
from experiment_runner.executors.opening import FINISH, open_run, remaining
from experiment_runner.executors.settings import RunConfig
from experiment_runner.plan.plan import Plan
from experiment_runner.report.tables import counted
from experiment_runner.slurm.batch import (
    MAX_TASKS,
    array_script,
    can_submit,
    check_folder,
    check_options,
    gathering_job,
    is_queued,
    submit,
)
from experiment_runner.slurm.parts import divide, gather
from experiment_runner.store.database import holds_run, reported
from experiment_runner.store.layout import PARTS, clear, replace_flushed
from experiment_runner.store.store import Store
from glue.console import say
from glue.errors import ConfigError, ExperimentError
from glue.files import read_text

_SCRIPT = "array.sh"
_JOB = "job"
"""Files in the folder of the parts: the script of the array, and its job number."""

_PROGRAM = [sys.executable, "-P", "-m", "glue_rl"]


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
    if not can_submit():
        raise ConfigError("--engine slurm submits with sbatch, which is not here: use a login node of SLURM")
    check_options(sbatch)
    check_folder(directory.absolute())
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
        tasks = divide(store, MAX_TASKS)
        options = [*resume_options(store, config), f"--checkpoint-every={config.checkpoint_every}"]
        if config.placement.in_process:
            options.append("--in-process")
        command = [*_PROGRAM, "experiment", *options, "--resume"]
        replace_flushed(parts / _SCRIPT, array_script(parts, command, tasks, config.workers, sbatch))
        job = submit([str(parts / _SCRIPT)])
        replace_flushed(parts / _JOB, job)
    what = f"{counted(left, 'trial')} in {counted(tasks, 'task')}"
    say(f"submitted job {job}: {what}, with output in {parts}")
    gathering = [*_PROGRAM, "results", "gather", str(directory.absolute())]
    try:
        submit(gathering_job(job, parts, gathering, sbatch))
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
    if number and is_queued(number):
        raise ExperimentError(
            f"job {number} has tasks of {directory} that wait or run: see squeue --jobs={number}, "
            f"and end it with scancel {number} if it is not wanted"
        )
    with Store.open(directory) as store:
        gathered, left = gather(store), len(remaining(store))
        if gathered and not left:
            store.record_event(FINISH, "all trials are finished")
        return left, len(store.trials())
