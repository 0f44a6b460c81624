"""Processes forked from one that has already imported everything: each starts almost instantly.

A short command spends most of its time on imports, and the tests run hundreds of commands. Use
`tests.terminal.run_anew` to test a command's start-up.
"""

from __future__ import annotations

import multiprocessing
import multiprocessing.connection
import os
import runpy
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable, Mapping, Sequence
from multiprocessing.context import ForkServerProcess
from pathlib import Path
from typing import Any, Final

BIN: Final = Path(sys.executable).parent

SERVER: Final = multiprocessing.get_context("forkserver")
SERVER.set_forkserver_preload(
    [
        "agents.mario.sample",
        "agents.mohan2010.flat",
        "agents.mohan2010.hierarchical",
        "agents.tabular",
        "env_server.cli.environment",
        "env_server.mario.environment",
        "env_server.cli.replay",
        "env_server.toys",
        "experiment_runner.cli.carrying_out",
        "experiment_runner.cli.experiment",
        "experiment_runner.cli.results",
        "experiment_runner.competition.board.forms",
        "experiment_runner.cli.compete",
        "experiment_runner.competition.organiser",
        "experiment_runner.executors.run",
        "experiment_runner.meeting.players",
        "experiment_runner.executors.recording",
        "experiment_runner.report.tables",
        "experiment_runner.view.server",
        "matplotlib.figure",
        "scipy.stats",
        "tests.forked",
        "tests.glue.conform.forked",
        "tests.glue.conform.wrong_experiment",
        "tests.scripted.process",
    ]
)


class Forked:
    """A function in a forked process; its result is the exit code.

    Several threads may use it at once. When one starts a process, `multiprocessing` polls all others: of two
    threads that read the same exit code, one would get 255.
    """

    _alone = threading.Lock()

    def __init__(self, run: Callable[..., int], *arguments: Any, daemon: bool = True) -> None:
        self._process: ForkServerProcess = SERVER.Process(target=_exit, args=(run, arguments), daemon=daemon)
        with self._alone:
            self._process.start()

    @property
    def pid(self) -> int:
        """The process ID."""
        assert self._process.pid is not None
        return self._process.pid

    def wait(self, seconds: float | None = None) -> int | None:
        """Wait for the end; return the exit code, -N after signal N, or None if `seconds` pass first."""
        multiprocessing.connection.wait([self._process.sentinel], seconds)
        with self._alone:
            return self._process.exitcode

    def kill(self) -> None:
        with self._alone:
            self._process.kill()
        multiprocessing.connection.wait([self._process.sentinel])


class Recorded(Forked):
    """A function in a forked process, with its output."""

    def __init__(self, run: Callable[..., int], *arguments: Any) -> None:
        self._folder = tempfile.TemporaryDirectory()
        self._printed = Path(self._folder.name) / "printed"
        super().__init__(_record, self._printed, run, arguments)

    def kill(self) -> None:
        super().kill()
        self._folder.cleanup()

    def output(self) -> str:
        return self._printed.read_text(errors="replace") if self._printed.exists() else ""


def run(
    *command: str, cwd: Path, env: Mapping[str, str] | None = None, timeout: float = 120
) -> subprocess.CompletedProcess[str]:
    """Run one of our commands to its end, as a script would; `env` is as in `subprocess.run`."""
    with tempfile.TemporaryDirectory() as folder:
        printed = [Path(folder) / name for name in ("stdout", "stderr")]
        process = start(*command, cwd=cwd, env=env, printed=printed)
        status = process.wait(timeout)
        if status is None:
            process.kill()
            raise subprocess.TimeoutExpired(command, timeout)
        return subprocess.CompletedProcess(command, status, *(path.read_text("utf-8") for path in printed))


def start(*command: str, cwd: Path, env: Mapping[str, str] | None = None, printed: Sequence[Path]) -> Forked:
    """Start one of our commands; its standard output and its errors are appended to two files."""
    environment = dict(os.environ if env is None else env)
    # A daemonic process cannot start processes.
    return Forked(_main, command, cwd, environment, printed, daemon=False)


def redirect(descriptor: int, path: Path) -> None:
    """Append to a file everything that this process writes to `descriptor`."""
    opened = os.open(path, os.O_CREAT | os.O_WRONLY | os.O_APPEND)
    os.dup2(opened, descriptor)
    os.close(opened)


def _exit(run: Callable[..., int], arguments: tuple[Any, ...]) -> None:
    raise SystemExit(run(*arguments))


def _record(printed: Path, run: Callable[..., int], arguments: tuple[Any, ...]) -> int:
    for descriptor in (1, 2):
        redirect(descriptor, printed)
    return run(*arguments)


def _main(command: Sequence[str], cwd: Path, env: Mapping[str, str], printed: Sequence[Path]) -> int:
    for stream, path in zip((sys.stdout, sys.stderr), printed, strict=True):
        redirect(stream.fileno(), path)
    os.environ.clear()
    os.environ.update(env)
    # Python reads the variable only at start-up.
    sys.path[:0] = filter(None, env.get("PYTHONPATH", "").split(os.pathsep))
    os.chdir(cwd)
    sys.argv = [str(BIN / command[0]), *command[1:]]
    runpy.run_path(sys.argv[0], run_name="__main__")
    return 0
