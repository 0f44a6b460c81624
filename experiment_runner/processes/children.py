"""Child processes: starting and ending them, and restarting players that are killed.

    python -P -m experiment_runner.processes.children PROGRAM ARGUMENTS...

runs a command or a module, as `python -m glue_rl` does, that ends with the process that started it.

Processes that notice the end of the process that started them, even if SIGKILL ends it.

The standard input of such a child is a pipe to which nothing is written: when it closes, the parent has
ended, or has no more use for the child. Little is imported, to keep small children small.
"""

from __future__ import annotations

import os
import runpy
import subprocess
import sys
import threading
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import IO, Any, Final, Protocol, Self

from glue.errors import ExperimentError


def spawn(
    module: str,
    arguments: Sequence[str],
    *,
    env: Mapping[str, str] | None = None,
    pass_fds: Sequence[int] = (),
) -> subprocess.Popen[bytes]:
    """Start a module that calls `watch_parent`.

    Ctrl-C in the terminal is not delivered to it. The working directory is not on its module path, where a
    file called random.py would break it.

    Args:
        module: run as `python -m` does.
        arguments: of its command line.
        env: its environment variables; None for those of this process.
        pass_fds: descriptors that it inherits.

    Raises:
        OSError: it cannot be started.
    """
    # A new program rather than a fork, which would share the lock of the run directory.
    return subprocess.Popen(
        [sys.executable, "-P", "-m", "glue_rl", module, *arguments],
        stdin=subprocess.PIPE,
        env=env,
        pass_fds=pass_fds,
        process_group=0,
    )


def watch_parent(ended: Callable[[], object]) -> threading.Thread:
    """Call `ended` in a thread, which is returned, when the parent ends or closes our standard input.

    Standard input is replaced, and a program that reads it gets end of file at once.
    """
    parent = os.dup(0)
    nothing = os.open(os.devnull, os.O_RDONLY)
    os.dup2(nothing, 0)
    os.close(nothing)

    def watch() -> None:
        os.read(parent, 1)
        ended()

    thread = threading.Thread(target=watch, name="parent", daemon=True)
    thread.start()
    return thread


Say = Callable[[str], None]
"""Shows a line of text."""

FAREWELL_SECONDS: Final = 3.0
"""Seconds that a child may take to exit after it was asked to."""

HURRIED_SECONDS: Final = 0.2
"""Seconds that a child may take to exit after Ctrl-C."""

_MAX_DEATHS: Final = 3
"""Number of times that a player may be killed without progress before it is given up."""


class Child(Protocol):
    """A child process: a `subprocess.Popen`, or an `experiment_runner.processes.warm.Fork`."""

    stdin: IO[bytes] | None
    returncode: int | Any

    def poll(self) -> int | None: ...

    def wait(self, timeout: float | None = None) -> int: ...

    def terminate(self) -> None: ...

    def kill(self) -> None: ...


def start(program: str, arguments: Sequence[str], pass_fds: Sequence[int] = ()) -> subprocess.Popen[bytes]:
    """Start a command, as in `view`, or a module as a child that ends when this process does.

    Raises:
        ExperimentError: it cannot be started.
    """
    try:
        return spawn("experiment_runner.processes.children", [program, *arguments], pass_fds=pass_fds)
    except OSError as error:
        raise ExperimentError(f"cannot start {' '.join([program, *arguments])}: {error}") from error


def end(process: Child, seconds: float = FAREWELL_SECONDS) -> None:
    """Wait for a child that was asked to exit; after `seconds` terminate it, then kill it."""
    for insist in (process.terminate, process.kill):
        try:
            process.wait(seconds)
        except subprocess.TimeoutExpired:
            insist()
    process.wait()
    _close_pipe(process)


def has_ended(process: Child) -> bool:
    """Return whether a child has ended; if so, it need not be passed to `end`."""
    if process.poll() is None:
        return False
    _close_pipe(process)
    return True


def how_it_ended(status: int) -> str:
    """Return a description of a child's exit status, as in `was killed by signal 9`."""
    return f"ended with status {status}" if status >= 0 else f"was killed by signal {-status}"


def _close_pipe(process: Child) -> None:
    assert process.stdin is not None
    process.stdin.close()


class KeptAlive:
    """A child process that is restarted when it is killed, and that ends with the context.

    A child that exits has reported the reason itself, and is not restarted unless `rest` says so; nor is one
    that is killed three times at the same episode.

    Args:
        label: names it in the lines that are shown.
        module, arguments: as for `start`.
        say: shows a line; called from any thread.
        progress: returns the number of finished episodes; called from any thread.
        give_up: called with the reason if it ends for good.
        dismissed: whether the hub tells it to exit when the context ends; otherwise it is terminated.
        rest: seconds after which it is restarted when it exits, too; None if it is not.

    Raises:
        ExperimentError: it cannot be started.
    """

    def __init__(
        self,
        label: str,
        module: str,
        arguments: Sequence[str],
        *,
        say: Say,
        progress: Callable[[], int],
        give_up: Callable[[str], None],
        dismissed: bool,
        rest: float | None = None,
    ) -> None:
        self._label = label
        self._start = partial(start, module, arguments)
        self._say = say
        self._progress = progress
        self._give_up = give_up
        self._dismissed = dismissed
        self._farewell = FAREWELL_SECONDS
        self._rest = rest
        self._leaving = threading.Event()
        self._lock = threading.Lock()  # after `_leave` no new process is started
        self._process = self._start()
        self._watcher = threading.Thread(target=self._watch, name=label, daemon=True)
        self._watcher.start()

    def hurry(self) -> None:
        """Terminate the child now: the run was interrupted."""
        self._farewell = HURRIED_SECONDS
        self._leave(terminate=True)

    def _leave(self, terminate: bool) -> None:
        """Stop restarting the process; terminate it if nothing else tells it to exit."""
        with self._lock:
            first = not self._leaving.is_set()
            self._leaving.set()
        if terminate and first:  # a second signal would interrupt its cleanup
            self._process.terminate()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._leave(terminate=not self._dismissed)
        end(self._process, self._farewell)
        self._watcher.join()

    def _watch(self) -> None:
        try:
            self._keep_alive()
        except Exception as error:  # otherwise nothing would notice that the player is gone
            self._give_up(f"the {self._label} cannot be restarted: {error}")

    def _keep_alive(self) -> None:
        deaths, furthest = 0, -1
        while True:
            status = self._process.wait()
            done = self._progress()
            deaths = deaths + 1 if done == furthest else 1
            furthest = done
            how = f"the {self._label} {how_it_ended(status)}"
            if status >= 0 and self._rest is not None:
                self._leaving.wait(self._rest)
            with self._lock:
                if self._leaving.is_set():
                    return
                if status >= 0 and self._rest is None:
                    self._give_up(how)
                    return
                if deaths == _MAX_DEATHS:
                    self._give_up(f"{how}, {deaths} times without getting past episode {done}")
                    return
                _close_pipe(self._process)
                self._process = self._start()
            self._say(f"{how}; it is being restarted")


def become_child() -> None:
    """Make this process end when its parent does."""
    watch_parent(lambda: os._exit(1))
    if "PYTHONBREAKPOINT" not in os.environ:
        sys.breakpointhook = _refuse_breakpoint


def main() -> None:
    """Run a command or a module that ends with its parent."""
    become_child()
    runpy.run_module("glue_rl", run_name="__main__", alter_sys=True)


def _refuse_breakpoint(*arguments: object, **options: object) -> None:
    raise ExperimentError(
        "breakpoint() needs the terminal, which a player in a separate process does not have: "
        "debug it with --in-process, without workers"
    )


if __name__ == "__main__":
    main()
