"""Run a trusted entrant's program: keep a bounded log of its output, and end the program with its organiser.

    python -P -m experiment_runner.competition.supervisor LOG SIZE PROGRAM ARGUMENTS...

When the organiser ends, or closes our standard input, the program and its process group are ended. This
process ends as the program did: with its status, or by the same signal.
"""

from __future__ import annotations

import os
import resource
import signal
import subprocess
import sys
import threading
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import BinaryIO, Final

from experiment_runner.processes.children import watch_parent
from glue.files import create_regular

MODULE: Final = "experiment_runner.competition.supervisor"

CANNOT_START: Final = 127
"""Exit status if there is no such program, as in a shell."""

_CHUNK: Final = 65_536
_GRACE_SECONDS: Final = 0.5
"""Time for the program to end after SIGTERM."""

_CUT = b"\n[the rest was not kept]\n"


def main() -> None:
    """Run the program that the arguments name."""
    log, size, *command = sys.argv[1:]
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_IGN)  # this process ends with its parent
    sys.exit(_supervise(Path(log), int(size), command))


def _supervise(log: Path, size: int, command: Sequence[str]) -> int:
    with create_regular(log) as kept:
        try:
            program = subprocess.Popen(
                command,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                process_group=0,
                restore_signals=True,
                preexec_fn=_default_signals,
            )
        except OSError as error:
            kept.write(f"cannot start {command[0]}: {error.strerror}\n".encode())
            return CANNOT_START
        watch_parent(lambda: _end(program))
        copying = threading.Thread(target=_copy, args=(program.stdout, kept, size), daemon=True)
        copying.start()
        try:
            status = program.wait()
        finally:
            _end(program)
        copying.join(_GRACE_SECONDS)  # a process of another group may keep the pipe open
    if status < 0:  # 128 - status, as of a shell, could be the program's own status
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        with suppress(OSError):  # SIGKILL is always fatal
            signal.signal(-status, signal.SIG_DFL)
        os.kill(os.getpid(), -status)
    return status


def _default_signals() -> None:
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_DFL)


def _copy(printed: BinaryIO, kept: BinaryIO, size: int) -> None:
    """Keep the first bytes of what the program prints, and read the rest, so that it need not wait."""
    while data := os.read(printed.fileno(), _CHUNK):
        if size > 0:
            with suppress(OSError, ValueError):  # the disk is full, or the log closed: not worth the trial
                kept.write(data[:size])
                kept.flush()
                size -= len(data)
                if size <= 0:
                    kept.write(_CUT)


def _end(program: subprocess.Popen[bytes]) -> None:
    """End the program and the rest of its process group."""
    for number in (signal.SIGTERM, signal.SIGKILL):
        with suppress(ProcessLookupError):
            os.killpg(program.pid, number)
        with suppress(subprocess.TimeoutExpired):
            program.wait(_GRACE_SECONDS)


if __name__ == "__main__":
    main()
