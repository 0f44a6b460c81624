"""Job arrays of SLURM: their script, their submission, and whether they are over.

Options and variables are those of https://slurm.schedmd.com/sbatch.html.
"""

from __future__ import annotations

import re
import shlex
import shutil
import subprocess
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from glue.errors import ConfigError, ExperimentError

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
            raise ConfigError(f"{option!r:.80} is no option for sbatch: write NAME=VALUE, as in time=2:00:00")


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
    quoted = (
        _pattern(folder).replace("\\", "\\\\").replace('"', '\\"')
    )  # a directive is read like a shell's line
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
