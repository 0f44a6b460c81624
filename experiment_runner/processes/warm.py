"""Processes that start at once: they are forked from one that has imported their module already.

    python -P -m experiment_runner.processes.warm DESCRIPTOR MODULE ARGUMENTS...

imports MODULE, and calls its function `prepare` with the arguments. Then it forks for every message on the
socket DESCRIPTOR, which brings three descriptors: of the child's job, of its standard input, and of a pipe to
which the child's process ID is written, and its exit status when it has ended. The child calls the module's
`main`.
"""

from __future__ import annotations

import importlib
import os
import select
import signal
import socket
import struct
import subprocess
import sys
import traceback
import warnings
from collections.abc import Mapping, Sequence
from contextlib import suppress
from typing import IO, Final, NoReturn

from experiment_runner.processes.children import become_child, end, spawn
from glue.closing import Closing
from glue.errors import ExperimentError

_MODULE: Final = "experiment_runner.processes.warm"
_NUMBER: Final = struct.Struct("<i")


class Warm(Closing):
    """A process that has imported a module, and forks.

    Args:
        module: has the functions `prepare`, called once with the arguments, and `main`, called in each fork
            with a descriptor as the only argument of its command line.
        arguments: of `prepare`.

    Raises:
        ExperimentError: it cannot be started.
    """

    def __init__(self, module: str, arguments: Sequence[str]) -> None:
        self._requests, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        try:
            with theirs:
                number = theirs.fileno()
                self._process = spawn(_MODULE, [str(number), module, *arguments], pass_fds=[number])
        except OSError as error:
            raise ExperimentError(f"cannot start {module}: {error}") from error

    def start(self, descriptor: int) -> Fork:
        """Return a new fork, which owns a copy of the descriptor.

        Raises:
            ExperimentError: the process is gone.
        """
        stdin, ours = os.pipe()
        status, theirs = os.pipe()
        try:
            socket.send_fds(self._requests, [b"1"], [descriptor, stdin, theirs])
        except OSError as error:
            raise ExperimentError(f"the process that starts workers has ended: {error}") from error
        finally:
            os.close(stdin)
            os.close(theirs)
        pid = os.read(status, _NUMBER.size)
        if not pid:
            raise ExperimentError("the process that starts workers has ended")
        return Fork(_NUMBER.unpack(pid)[0], os.fdopen(ours, "wb", 0), status)

    def close(self) -> None:
        """End the process; its forks are not affected."""
        self._requests.close()
        end(self._process)


class Fork:
    """A process forked by a `Warm`, with the methods of `subprocess.Popen` that `children.Child` names.

    Args:
        pid: its process ID.
        stdin: when it is closed, the process ends.
        status: descriptor from which the exit status is read.
    """

    def __init__(self, pid: int, stdin: IO[bytes], status: int) -> None:
        self.stdin: IO[bytes] | None = stdin
        self.returncode: int | None = None
        self._pid = pid
        self._status = os.fdopen(status, "rb", 0)

    def poll(self) -> int | None:
        """Return the exit status, -N after signal N; None while the process is alive."""
        with suppress(subprocess.TimeoutExpired):
            self.wait(0.0)
        return self.returncode

    def wait(self, timeout: float | None = None) -> int:
        """Wait for the end; return the exit status.

        Raises:
            subprocess.TimeoutExpired: it did not end in time.
        """
        if self.returncode is None:
            ready = select.poll()  # `select.select` takes no descriptor above 1023
            ready.register(self._status, select.POLLIN)
            if not ready.poll(None if timeout is None else 1000 * timeout):
                raise subprocess.TimeoutExpired(_MODULE, timeout or 0.0)
            if data := self._status.read(_NUMBER.size):
                self.returncode = int(_NUMBER.unpack(data)[0])
            else:  # the process that forked it has ended
                self.kill()
                self.returncode = -signal.SIGKILL
            self._status.close()
        return self.returncode

    def terminate(self) -> None:
        """Send SIGTERM, unless it has ended."""
        self._signal(signal.SIGTERM)

    def kill(self) -> None:
        """Send SIGKILL, unless it has ended."""
        self._signal(signal.SIGKILL)

    def _signal(self, number: int) -> None:
        if self.returncode is None:
            with suppress(ProcessLookupError):
                os.kill(self._pid, number)


def main() -> None:
    """Import the module, and fork until the other end of the socket is closed."""
    requests, module, *arguments = sys.argv[1:]
    importlib.import_module(module).prepare(arguments)
    with socket.socket(fileno=int(requests)) as messages:
        _serve(messages, module)


def _serve(messages: socket.socket, module: str) -> None:
    ready = select.poll()
    ready.register(messages, select.POLLIN)
    running: dict[int, tuple[int, int]] = {}
    """By the descriptor of each child: its process ID, and the pipe for its status."""
    while True:
        for descriptor, _ in ready.poll():
            if descriptor in running:
                ready.unregister(descriptor)
                pid, status = running.pop(descriptor)
                _tell(status, os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]))
                os.close(descriptor)
                os.close(status)
                continue
            message, descriptors, _, _ = socket.recv_fds(messages, 1, 3)
            if not message:
                return
            job, stdin, status = descriptors
            with warnings.catch_warnings():
                # Threads of numerical libraries, which stop them before a fork and start them again.
                warnings.simplefilter("ignore", DeprecationWarning)
                pid = os.fork()
            if not pid:
                _become(messages, running, module, job, stdin, status)
            os.close(job)
            os.close(stdin)
            _tell(status, pid)
            child = os.pidfd_open(pid)
            running[child] = pid, status
            ready.register(child, select.POLLIN)


def _become(
    messages: socket.socket,
    running: Mapping[int, tuple[int, int]],
    module: str,
    job: int,
    stdin: int,
    status: int,
) -> NoReturn:
    """Run the module in a new child."""
    code = 1
    try:
        messages.close()
        for descriptor, (_, other) in running.items():
            os.close(descriptor)
            os.close(other)
        os.close(status)
        os.setpgid(0, 0)
        os.dup2(stdin, 0)
        os.close(stdin)
        become_child()
        sys.argv = [module, str(job)]
        sys.modules[module].main()
        code = 0
    except SystemExit as error:
        code = error.code if isinstance(error.code, int) else 1
    except BaseException as error:
        traceback.print_exception(error)
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)


def _tell(pipe: int, number: int) -> None:
    with suppress(BrokenPipeError):
        os.write(pipe, _NUMBER.pack(number))


if __name__ == "__main__":
    main()
