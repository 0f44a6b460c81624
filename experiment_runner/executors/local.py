"""Run trials in parallel on this machine, each in its own process.

So a trial that crashes its process affects neither other trials nor the store. A worker receives its job
over a socket, and sends its reports over the same socket:

    python -P -m experiment_runner.children experiment_runner.executors.local DESCRIPTOR
"""

from __future__ import annotations

import contextlib
import select
import signal
import socket
import subprocess
import sys
from types import FrameType, TracebackType
from typing import Any, Final, NoReturn, Self

from experiment_runner.children import FAREWELL_SECONDS, HURRIED_SECONDS, end, has_ended, how_it_ended, start
from experiment_runner.executors.job import (
    Ended,
    Job,
    Lost,
    Report,
    decode_job,
    decode_report,
    encode_job,
    encode_report,
    run_job,
    unpacker,
)
from experiment_runner.interrupts import Interrupts
from glue.commands import Terminated
from glue.errors import ExperimentError

__all__ = ["LocalExecutor", "main"]

_MODULE: Final = "experiment_runner.executors.local"
_CHUNK: Final = 2**18


class LocalExecutor:
    """Worker processes; see `experiment_runner.executors.dispatch.Executor`.

    Args:
        size: maximum number of concurrent trials.
    """

    def __init__(self, size: int) -> None:
        self.size = size
        self._workers: dict[int, _Worker] = {}
        self._poll = select.poll()
        self._leaving: list[subprocess.Popen[bytes]] = []
        self._stopping = False

    def start(self, job: Job) -> None:
        """Run a trial.

        Raises:
            ExperimentError: the process cannot be started.
        """
        worker = _Worker(job)
        self._workers[worker.descriptor] = worker
        self._poll.register(worker.descriptor, select.POLLIN)

    def receive(self, seconds: float) -> list[tuple[str, Report]]:
        """Return reports with the ids of their trials, in order for each trial; wait at most `seconds`."""
        received: list[tuple[str, Report]] = []
        for descriptor, _ in self._poll.poll(seconds * 1000):
            worker = self._workers[descriptor]
            for report in worker.read():
                received.append((worker.trial_id, report))
                if isinstance(report, (Ended, Lost)):
                    self._forget(worker)
        self._leaving = [process for process in self._leaving if not has_ended(process)]
        return received

    def stop(self) -> None:
        """Ask the workers to end soon, with a checkpoint if the running episode ends in time."""
        self._stopping = True
        for worker in self._workers.values():
            worker.process.terminate()

    def _forget(self, worker: _Worker) -> None:
        del self._workers[worker.descriptor]
        self._poll.unregister(worker.descriptor)
        worker.close()
        self._leaving.append(worker.process)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if not self._stopping:
            self.stop()
        for worker in list(self._workers.values()):
            self._forget(worker)
        interrupted = kind is not None and issubclass(kind, KeyboardInterrupt)
        for process in self._leaving:
            end(process, HURRIED_SECONDS if interrupted else FAREWELL_SECONDS)


class _Worker:
    """A process that runs one trial, and our end of its socket."""

    def __init__(self, job: Job) -> None:
        self.trial_id = job.spec.id
        self._socket, theirs = socket.socketpair()
        with theirs:
            self.process = start(_MODULE, [str(theirs.fileno())], pass_fds=[theirs.fileno()])
        self.descriptor = self._socket.fileno()
        self._unpacker = unpacker()
        with contextlib.suppress(OSError):  # it has ended already, as `read` will find
            self._socket.sendall(encode_job(job))

    def read(self) -> list[Report]:
        """Return the reports received; the last is `Lost` if the worker has ended."""
        reports: list[Report] = []
        try:
            data = self._socket.recv(_CHUNK)
            self._unpacker.feed(data)
            reports += map(decode_report, self._unpacker)
        except ConnectionError:
            data = b""
        except (ValueError, ExperimentError) as error:  # the trial's own code wrote to the socket
            self.process.kill()
            return [*reports, Lost(f"its worker sent something other than reports: {error}")]
        if not data:
            end(self.process)
            reports.append(Lost(f"its worker {how_it_ended(self.process.returncode)}"))
        return reports

    def close(self) -> None:
        """Close our end of the socket."""
        self._socket.close()


def main() -> None:
    """Run the job received over the socket whose descriptor is the first argument."""
    signal.signal(signal.SIGTERM, _terminate)
    with contextlib.suppress(Terminated), socket.socket(fileno=int(sys.argv[1])) as parent:

        def send(report: Report) -> None:
            try:
                parent.sendall(encode_report(report))
            except OSError:
                raise Terminated from None  # the experiment is over

        with Interrupts() as interrupts:
            run_job(decode_job(_receive(parent)), send, interrupts=interrupts)


def _receive(parent: socket.socket) -> Any:
    received = unpacker()
    while data := parent.recv(_CHUNK):
        received.feed(data)
        for value in received:
            return value
    raise Terminated  # the experiment ended before it sent a job


def _terminate(number: int, frame: FrameType | None) -> NoReturn:
    raise Terminated


if __name__ == "__main__":
    main()
