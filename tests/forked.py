"""Processes forked from one that has already imported everything: each starts almost instantly.

A short command spends most of its time on imports, and the tests run hundreds of commands. The players and
workers of such a command are forked from it, too. Use `tests.terminal.run_anew` to test a command's start-up.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import multiprocessing.connection
import os
import runpy
import signal
import subprocess
import sys
import tempfile
import threading
import traceback
import warnings
from collections.abc import Callable, Collection, Mapping, Sequence
from multiprocessing.context import ForkServerProcess
from pathlib import Path
from typing import Any, Final

from experiment_runner.plan.provenance import about
from experiment_runner.plan.user_files import user_files
from experiment_runner.processes import children, warm

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
        "experiment_runner.cli.run_plan",
        "experiment_runner.cli.experiment",
        "experiment_runner.cli.results",
        "experiment_runner.competition.board.forms",
        "experiment_runner.cli.compete",
        "experiment_runner.competition.organiser",
        "experiment_runner.executors.run",
        "experiment_runner.executors.over_hub",
        "experiment_runner.executors.recording",
        "experiment_runner.report.tables",
        "experiment_runner.view.server",
        "matplotlib.figure",
        "tests.forked",
        "tests.glue.conform.forked",
        "tests.glue.conform.right",
        "tests.scripted.process",
    ]
)


about()  # what is installed is found out once, for all commands
user_files([])


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
    *command: str,
    cwd: Path,
    env: Mapping[str, str] | None = None,
    timeout: float = 120,
    status: int | None = None,
) -> subprocess.CompletedProcess[str]:
    """Run one of our commands to its end, as a script would.

    `env` is as in `subprocess.run`; `status` is the exit status that the command must have, if one is given.
    """
    with tempfile.TemporaryDirectory() as folder:
        printed = [Path(folder) / name for name in ("stdout", "stderr")]
        process = start(*command, cwd=cwd, env=env, printed=printed)
        ended = process.wait(timeout)
        if ended is None:
            process.kill()
            raise subprocess.TimeoutExpired(command, timeout)
        out, errors = (path.read_text("utf-8") for path in printed)
        assert status in (None, ended), f"{' '.join(command)} ended with {ended}:\n{out}{errors}"
        return subprocess.CompletedProcess(command, ended, out, errors)


def start(*command: str, cwd: Path, env: Mapping[str, str] | None = None, printed: Sequence[Path]) -> Forked:
    """Start one of our commands; its standard output and its errors are appended to two files."""
    environment = dict(os.environ if env is None else env)
    # A daemonic process cannot start processes.
    return Forked(_main, command, cwd, environment, printed, daemon=False)


class _Child(subprocess.Popen[bytes]):
    """A module in a process forked from this one, in place of `experiment_runner.processes.children.spawn`.

    It keeps no descriptor of this process but the standard ones and `pass_fds`, and has signals as a new one.
    """

    def __init__(self, module: str, arguments: Sequence[str], *, pass_fds: Sequence[int] = ()) -> None:
        for stream in (sys.stdout, sys.stderr):
            stream.flush()
        reader, writer = os.pipe()
        with warnings.catch_warnings(
            action="ignore", category=DeprecationWarning
        ):  # this process has threads
            # Otherwise this process's handlers might run in the other one, with a copy of its stack.
            before = signal.pthread_sigmask(signal.SIG_BLOCK, (signal.SIGINT, signal.SIGTERM))
            pid = os.fork()
        if not pid:
            os._exit(_become(module, arguments, reader, pass_fds, before))
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
        os.close(reader)
        self.pid, self.args, self.returncode = pid, [module, *arguments], None
        self.stdin, self.stdout, self.stderr = os.fdopen(writer, "wb", 0), None, None
        self._child_created, self._waitpid_lock = True, threading.Lock()


def _become(
    module: str, arguments: Sequence[str], stdin: int, pass_fds: Sequence[int], mask: Collection[int]
) -> int:
    """Run a module in this process, just forked with signals blocked; return its exit status."""
    os.setpgid(0, 0)
    os.dup2(stdin, 0)
    for number in map(int, os.listdir("/proc/self/fd")):
        if number > 2 and number not in pass_fds:
            with contextlib.suppress(OSError):
                os.close(number)
    signal.set_wakeup_fd(-1)
    signal.signal(signal.SIGINT, signal.default_int_handler)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    signal.pthread_sigmask(signal.SIG_SETMASK, mask)
    warnings.filterwarnings("ignore", category=RuntimeWarning, module="runpy")  # it was imported already
    sys.argv = ["glue_rl", module, *arguments]
    try:
        runpy.run_module("glue_rl", run_name="__main__", alter_sys=True)
        code: object = 0
    except SystemExit as ending:
        code = ending.code
    except BaseException:
        traceback.print_exc()
        code = 1
    for stream in (sys.stdout, sys.stderr):
        stream.flush()
    return code if isinstance(code, int) else 0 if code is None else 1


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
    for name, descriptor, path in zip(("stdout", "stderr"), (1, 2), printed, strict=True):
        redirect(descriptor, path)
        # New ones, because the old ones know whether their first file could seek.
        setattr(sys, name, os.fdopen(descriptor, "w", encoding="utf-8", buffering=1, closefd=False))
    os.environ.clear()
    os.environ.update(env)
    # Python reads the variable only at start-up.
    sys.path[:0] = filter(None, env.get("PYTHONPATH", "").split(os.pathsep))
    os.chdir(cwd)
    vars(children)["spawn"] = vars(warm)["spawn"] = _Child
    sys.argv = [str(BIN / command[0]), *command[1:]]
    runpy.run_path(sys.argv[0], run_name="__main__")
    return 0
