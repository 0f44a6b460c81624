"""Child processes: how they are started, how they end, and players that are started again when killed."""

from __future__ import annotations

import subprocess
import sys
import threading
from collections.abc import Callable, Sequence
from typing import Final, Self

from glue.errors import ExperimentError

__all__ = ["KeptAlive", "Say", "end", "has_ended", "how_it_ended", "start"]

Say = Callable[[str], None]
"""Takes a line for people."""

_HOPELESS_DEATHS: Final = 3
_FAREWELL_SECONDS: Final = 3.0


def start(module: str, arguments: Sequence[str], pass_fds: Sequence[int] = ()) -> subprocess.Popen[bytes]:
    """Start a module as a child that ends when this process does, whatever ends it.

    Ctrl-C in the terminal does not reach it: that is for this process, which then ends its children.

    Raises:
        ExperimentError: it cannot be started.
    """
    command = [sys.executable, "-m", "experiment_runner.executors.child", module, *arguments]
    try:
        # A fresh program, not a fork of this one: a fork would share the lock of the run directory.
        return subprocess.Popen(command, stdin=subprocess.PIPE, pass_fds=pass_fds, process_group=0)
    except OSError as error:
        raise ExperimentError(f"cannot start {' '.join([module, *arguments])}: {error}") from error


def end(process: subprocess.Popen[bytes]) -> None:
    """Wait a moment for a child that has been told to leave; then insist."""
    for insist in (process.terminate, process.kill):
        try:
            process.wait(_FAREWELL_SECONDS)
        except subprocess.TimeoutExpired:
            insist()
    process.wait()
    _let_go(process)


def has_ended(process: subprocess.Popen[bytes]) -> bool:
    """Return whether a child is gone; if so, nothing is left of it to `end`."""
    if process.poll() is None:
        return False
    _let_go(process)
    return True


def how_it_ended(status: int) -> str:
    """Return what a child's status says, as in `was killed by signal 9`."""
    return f"ended with status {status}" if status >= 0 else f"was killed by signal {-status}"


def _let_go(process: subprocess.Popen[bytes]) -> None:
    assert process.stdin is not None
    process.stdin.close()


class KeptAlive:
    """Children that are started again when they are killed, and end with the context.

    One that ends by itself has said why, and is not started again; nor is one that is killed three times
    without any progress.

    Args:
        say: takes lines for people, from any thread.
        progress: returns how many episodes are done; called from any thread.
        sent_off: whether somebody tells them to leave when the context ends; if not, they are made to.
    """

    def __init__(self, say: Say, progress: Callable[[], int], sent_off: bool) -> None:
        self._say = say
        self._progress = progress
        self._sent_off = sent_off
        self._children: list[_Child] = []

    def start(
        self, label: str, module: str, arguments: Sequence[str], give_up: Callable[[str], None]
    ) -> None:
        """Start a module. If it cannot be kept alive, `give_up` is called with the reason.

        Raises:
            ExperimentError: it cannot be started.
        """
        self._children.append(_Child(label, module, arguments, self._say, self._progress, give_up))

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        for child in self._children:
            child.leave(self._sent_off)
        for child in self._children:
            child.end()


class _Child:
    """One child and the thread that watches it."""

    def __init__(
        self,
        label: str,
        module: str,
        arguments: Sequence[str],
        say: Say,
        progress: Callable[[], int],
        give_up: Callable[[str], None],
    ) -> None:
        self._label = label
        self._module = module
        self._arguments = arguments
        self._say = say
        self._progress = progress
        self._give_up = give_up
        self._leaving = False
        self._lock = threading.Lock()  # no new process once it is leaving
        self._process = start(module, arguments)
        self._watcher = threading.Thread(target=self._watch, name=label, daemon=True)
        self._watcher.start()

    def leave(self, sent_off: bool) -> None:
        """From now on the process may end, or has to."""
        with self._lock:
            self._leaving = True
        if not sent_off:
            self._process.terminate()

    def end(self) -> None:
        """Let the process end, as it does when its hub says goodbye."""
        end(self._process)
        self._watcher.join()

    def _watch(self) -> None:
        deaths, furthest = 0, -1
        while True:
            status = self._process.wait()
            done = self._progress()
            deaths = deaths + 1 if done == furthest else 1
            furthest = done
            how = f"the {self._label} {how_it_ended(status)}"
            with self._lock:
                if self._leaving:
                    return
                if status >= 0:
                    self._give_up(how)
                    return
                if deaths == _HOPELESS_DEATHS:
                    self._give_up(f"{how}, {deaths} times without getting past episode {done}")
                    return
                _let_go(self._process)
                self._process = start(self._module, self._arguments)
            self._say(f"{how}; it is started again")
