"""A process that runs one trial for `workers`: it is sent a job and sends reports."""

from __future__ import annotations

import contextlib
import signal
import sys
from multiprocessing.connection import Connection
from types import FrameType
from typing import NoReturn

from experiment_runner.executors.work import Report, work
from glue.commands import Terminated

__all__ = ["main"]


def main() -> None:
    """Run the job that comes over the socket whose number is the first argument."""
    signal.signal(signal.SIGTERM, _terminate)
    with contextlib.suppress(Terminated, EOFError), Connection(int(sys.argv[1])) as connection:

        def send(report: Report) -> None:
            try:
                connection.send(report)
            except OSError:
                raise Terminated from None  # nobody takes it: the experiment is over

        work(connection.recv(), send)


def _terminate(number: int, frame: FrameType | None) -> NoReturn:
    raise Terminated


if __name__ == "__main__":
    main()
