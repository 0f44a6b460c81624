"""Job arrays of SLURM: the parts of a run that their tasks continue, their script, and their submission.

A part is a run directory in the folder `parts` of its run, with the same plan and some of the trials. One
task continues it like any other run, so that no two processes write to the same database.

Options and variables are those of https://slurm.schedmd.com/sbatch.html.
"""

from __future__ import annotations

import re
import shlex
import shutil
import subprocess
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Final

from experiment_runner.store.database import reported
from experiment_runner.store.layout import ABOUT_FILE, PARTS, PLAN_FILE, parts_of, remove_run
from experiment_runner.store.store import Store
from glue.errors import ConfigError, ExperimentError
from glue.files import read_text

MAX_TASKS: Final = 1000
"""Maximum number of tasks of an array: SLURM's default MaxArraySize is 1001."""

_NOTICE_SECONDS: Final = 60
"""Time between SIGTERM and the end of a task's time limit, in which its checkpoint is written."""

_SECONDS: Final = 60.0
"""Time within which a SLURM command has to answer."""

_OPTION: Final = re.compile(r"[a-z][a-z-]*(=[^\s\x00-\x1f]+)?")


def can_submit() -> bool:
    """Return whether SLURM's commands are installed on this machine."""
    return shutil.which("sbatch") is not None


def check_options(options: Sequence[str]) -> None:
    """Check options for sbatch.

    Raises:
        ConfigError: an option does not have the form NAME or NAME=VALUE.
    """
    for option in options:
        if not _OPTION.fullmatch(option):
            raise ConfigError(f"{option!r:.80} is not a sbatch option: write NAME=VALUE, as in time=2:00:00")


def check_folder(folder: Path) -> None:
    """Check that SLURM can be given a path in the lines of a script.

    Raises:
        ConfigError: it has a line break, or another character that cannot be shown.
    """
    if not str(folder).isprintable():
        raise ConfigError(
            f"SLURM cannot be given the path {str(folder)!r}: choose a directory with --out, on one line"
        )


def array_script(
    folder: Path, command: Sequence[str], tasks: int, at_once: int | None, options: Sequence[str]
) -> str:
    """Return the script of a job array whose task N continues part N.

    Args:
        folder: absolute path of the parts, which also receives the output of the tasks.
        command: command that continues a run, without the run's path.
        tasks: number of tasks.
        at_once: maximum number of tasks that run at the same time; None for no limit.
        options: further options for sbatch, as NAME or NAME=VALUE.
    """
    # A directive is read like a shell's line.
    quoted = _pattern(folder).replace("\\", "\\\\").replace('"', '\\"')
    limit = "" if at_once is None else f"%{at_once}"
    ours = [
        f"array=0-{tasks - 1}{limit}",
        f'output="{quoted}/%a.log"',
        "open-mode=append",
        "requeue",
        f"signal=B:TERM@{_NOTICE_SECONDS}",
    ]
    lines = ["#!/bin/sh", *(f"#SBATCH --{option}" for option in (*ours, *options))]
    # The task's process takes the place of the shell, and so receives the signals of the scheduler.
    lines.append(f'exec {shlex.join(command)} {shlex.quote(str(folder))}/"$SLURM_ARRAY_TASK_ID"')
    return "\n".join(lines) + "\n"


def gathering_job(job: str, folder: Path, command: Sequence[str], options: Sequence[str]) -> list[str]:
    """Return the arguments of `submit` for a command that runs when all tasks of an array are over.

    Args:
        job: number of the array's job.
        folder: absolute path of the parts, which also receives the output of the command.
        command: the command.
        options: further options for sbatch, like those of the array.
    """
    ours = [f"dependency=afterany:{job}", f"output={_pattern(folder)}/gather.log", "open-mode=append"]
    return [*(f"--{option}" for option in (*ours, *options)), f"--wrap=exec {shlex.join(command)}"]


def _pattern(folder: Path) -> str:
    """Return a path for SLURM, which replaces `%a` and its kin."""
    return str(folder).replace("%", "%%")


def submit(arguments: Sequence[str]) -> str:
    """Submit a job, and return its number.

    Args:
        arguments: of sbatch.

    Raises:
        ExperimentError: SLURM refused the job.
    """
    return _run("sbatch", "--parsable", *arguments).partition(";")[0]


def is_queued(job: str) -> bool:
    """Return whether a job waits or runs; False on a machine without SLURM, which cannot know.

    Raises:
        ExperimentError: SLURM does not answer.
    """
    if shutil.which("squeue") is None:
        return False
    try:
        return bool(_run("squeue", "--noheader", "--states=PENDING,RUNNING,SUSPENDED", f"--jobs={job}"))
    except ExperimentError as error:
        if "Invalid job id" in str(error):  # the job ended longer ago than SLURM remembers
            return False
        raise


def _run(*command: str) -> str:
    try:
        done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=_SECONDS)
    except (OSError, subprocess.TimeoutExpired) as error:
        raise ExperimentError(f"cannot run {command[0]}: {error}") from error
    if done.returncode:
        why = done.stderr.strip().removeprefix(f"{command[0]}: error: ")
        raise ExperimentError(f"{command[0]} has failed: {why}")
    return done.stdout.strip()


def divide(store: Store, tasks: int) -> int:
    """Make a part for each task, named by its number from 0; return the number of parts.

    Args:
        store: of the run, which has no parts.
        tasks: maximum number of parts. Their numbers of trials differ by at most one.

    Raises:
        ExperimentError: a part cannot be written.
    """
    left = [trial for trial in store.trials() if not trial.finished]
    with reported(f"cannot read {store.directory}"):
        files = {name: read_text(store.directory / name) for name in (PLAN_FILE, ABOUT_FILE)}
    count = min(tasks, len(left))
    for number in range(count):
        share = left[number::count]
        Store.create(
            store.directory / PARTS / str(number),
            [trial.spec for trial in share],
            files,
            fill=partial(_copy, store, [trial.spec.id for trial in share if trial.done]),
        ).close()
    return count


def _copy(source: Store, trial_ids: list[str], part: Store) -> None:
    for trial_id in trial_ids:
        part.adopt(source, trial_id, trial_id)


def gather(store: Store) -> int:
    """Move the results of all parts to their run; return the number of parts.

    A kill in between loses nothing: a part is removed after its results are stored.

    Raises:
        DirectoryTaken: a task is running.
        ExperimentError: a part cannot be read, or the results cannot be written.
    """
    parts = parts_of(store.directory)
    for path in parts:
        with Store.open(path) as part:
            for trial in part.trials():
                if trial.done >= store.done(trial.spec.id):
                    store.adopt(part, trial.spec.id, trial.spec.id)
        with reported(f"cannot remove {path}"):
            remove_run(path)
    return len(parts)
