"""Run trials in parallel on this machine, each in its own process.

A trial that crashes its process thus affects neither other trials nor the store. A worker receives its job
and sends its reports over one socket:

    python -P -m experiment_runner.processes.children experiment_runner.executors.workers DESCRIPTOR
"""

from __future__ import annotations

import contextlib
import select
import signal
import socket
import sys
from collections.abc import Callable, Mapping, Sequence
from types import FrameType, TracebackType
from typing import Any, Final, NamedTuple, NoReturn, Self

from experiment_runner.executors.interrupts import Interrupts, Terminated
from experiment_runner.executors.job import REPORTS, Ended, Lost, decode, decode_job, encode, unpacker
from experiment_runner.executors.trial import run_job
from experiment_runner.processes.children import (
    FAREWELL_SECONDS,
    HURRIED_SECONDS,
    Child,
    end,
    has_ended,
    how_it_ended,
    start,
)
from experiment_runner.processes.warm import Warm
from glue.errors import ExperimentError

_MODULE: Final = "experiment_runner.executors.workers"
_CHUNK: Final = 2**18


class _Worker(NamedTuple):
    """A process that runs one trial, and our end of its socket."""

    trial_id: str
    process: Child
    socket: socket.socket
    unpacker: Any


class LocalExecutor:
    """Worker processes; see `experiment_runner.executors.dispatcher.Executor`.

    Args:
        size: maximum number of concurrent trials.
        module: the module that a worker runs; its `main` calls `serve`.
        reports: types of its reports by name; a worker's last report is `Ended`.
        warm: arguments of the module's `prepare`, if workers are to be forked from a process that has called
            it; None to start each anew.
    """

    def __init__(
        self,
        size: int,
        module: str = _MODULE,
        reports: Mapping[str, type[Any]] = REPORTS,
        warm: Sequence[str] | None = None,
    ) -> None:
        self.size = size
        self._module = module
        self._reports = reports
        self._workers: dict[int, _Worker] = {}
        self._poll = select.poll()
        self._leaving: list[Child] = []
        self._stopping = False
        self._arguments = warm
        self._warm: Warm | None = None

    def start(self, job: Any) -> None:
        """Run a trial.

        Raises:
            ExperimentError: the process cannot be started.
        """
        if self._arguments is not None and self._warm is None:
            self._warm = Warm(self._module, self._arguments)
        ours, theirs = socket.socketpair()
        with theirs:
            number = theirs.fileno()
            if self._warm is not None:
                process: Child = self._warm.start(number)
            else:
                process = start(self._module, [str(number)], pass_fds=[number])
        with contextlib.suppress(OSError):  # the process has ended already, which `_read` will detect
            ours.sendall(encode(job))
        self._workers[ours.fileno()] = _Worker(job.spec.id, process, ours, unpacker())
        self._poll.register(ours, select.POLLIN)

    def receive(self, seconds: float) -> list[tuple[str, Any]]:
        """Return reports with the ids of their trials, in order for each trial; wait at most `seconds`."""
        received: list[tuple[str, Any]] = []
        for descriptor, _ in self._poll.poll(seconds * 1000):
            worker = self._workers[descriptor]
            for report in self._read(worker):
                received.append((worker.trial_id, report))
                if isinstance(report, (Ended, Lost)):
                    self._forget(descriptor)
        self._leaving = [process for process in self._leaving if not has_ended(process)]
        return received

    def cancel(self, trial_id: str) -> None:
        """Kill the worker of a trial."""
        for descriptor, worker in list(self._workers.items()):
            if worker.trial_id == trial_id:
                worker.process.kill()
                self._forget(descriptor)

    def stop(self) -> None:
        """Ask the workers to end soon, with a checkpoint if the running episode ends in time."""
        self._stopping = True
        for worker in self._workers.values():
            worker.process.terminate()

    def _read(self, worker: _Worker) -> list[Any]:
        """Return the reports of a worker; the last is `Lost` if it has ended."""
        reports: list[Any] = []
        try:
            data = worker.socket.recv(_CHUNK)
            worker.unpacker.feed(data)
            reports += (decode(value, self._reports) for value in worker.unpacker)
        except ConnectionError:
            data = b""
        except (ValueError, ExperimentError) as error:  # the trial's own code wrote to the socket
            worker.process.kill()
            return [*reports, Lost(f"its worker sent something other than reports: {error}")]
        if not data:
            end(worker.process)
            reports.append(Lost(f"its worker {how_it_ended(worker.process.returncode)}"))
        return reports

    def _forget(self, descriptor: int) -> None:
        worker = self._workers.pop(descriptor)
        self._poll.unregister(descriptor)
        worker.socket.close()
        self._leaving.append(worker.process)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if not self._stopping:
            self.stop()
        for descriptor in list(self._workers):
            self._forget(descriptor)
        interrupted = kind is not None and issubclass(kind, KeyboardInterrupt)
        for process in self._leaving:
            end(process, HURRIED_SECONDS if interrupted else FAREWELL_SECONDS)
        if self._warm is not None:
            self._warm.close()


def main() -> None:
    """Run the job received over the socket whose descriptor is the first argument."""

    def run(value: Any, send: Callable[[object], None]) -> None:
        job = decode_job(value)
        with Interrupts(job.config.grace) as interrupts:
            run_job(job, send, interrupts=interrupts)

    serve(run)


def serve(run: Callable[[Any, Callable[[object], None]], None]) -> None:
    """Run a worker: receive one job over the socket whose descriptor is the first argument, and run it.

    Args:
        run: called with the unpacked job, and a function that sends a report.
    """
    signal.signal(signal.SIGTERM, _terminate)
    with contextlib.suppress(Terminated), socket.socket(fileno=int(sys.argv[1])) as parent:

        def send(report: object) -> None:
            try:
                parent.sendall(encode(report))
            except OSError:
                raise Terminated from None  # the experiment is over

        run(_receive(parent), send)


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
