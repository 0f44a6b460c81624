"""Trials in parallel processes of this machine, one process for each trial.

So whatever a trial does to its process, the other trials and the store know nothing of it.
"""

from __future__ import annotations

import contextlib
import subprocess
from multiprocessing.connection import Connection, Pipe, wait
from typing import Final, Self

from experiment_runner.executors.children import end, has_ended, how_it_ended, start
from experiment_runner.executors.work import Ended, Job, Lost, Report

__all__ = ["Workers"]

_MODULE: Final = "experiment_runner.executors.worker"


class Workers:
    """A pool of processes; see `experiment_runner.executors.distribute.Pool`.

    Args:
        size: trials at a time.
    """

    def __init__(self, size: int) -> None:
        self.size = size
        self._running: dict[Connection, tuple[str, subprocess.Popen[bytes]]] = {}
        self._leaving: list[subprocess.Popen[bytes]] = []

    def start(self, job: Job) -> None:
        """Run a trial.

        Raises:
            ExperimentError: the process cannot be started.
        """
        ours, theirs = Pipe()
        with theirs:
            process = start(_MODULE, [str(theirs.fileno())], pass_fds=[theirs.fileno()])
        self._running[ours] = (job.spec.id, process)
        with contextlib.suppress(OSError):  # it is dead already, as `receive` will find
            ours.send(job)

    def receive(self) -> list[tuple[str, Report]]:
        """Wait for reports; return them with the id of their trial."""
        ready = wait(list(self._running))
        return [self._read(connection) for connection in list(self._running) if connection in ready]

    def _read(self, connection: Connection) -> tuple[str, Report]:
        trial_id, process = self._running[connection]
        try:
            report: Report = connection.recv()
        except (EOFError, OSError):  # nobody is at the other end, perhaps since the middle of a report
            end(self._forget(connection))
            return trial_id, Lost(f"its worker {how_it_ended(process.returncode)}")
        if isinstance(report, Ended):
            self._leaving = [other for other in self._leaving if not has_ended(other)]
            self._leaving.append(self._forget(connection))
        return trial_id, report

    def _forget(self, connection: Connection) -> subprocess.Popen[bytes]:
        _, process = self._running.pop(connection)
        connection.close()
        return process

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        for _id, process in self._running.values():
            process.terminate()
        for process in [*self._leaving, *map(self._forget, list(self._running))]:
            end(process)
