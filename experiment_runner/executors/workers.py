"""Run trials in parallel, each in its own process: on this machine, or on a Ray cluster (extra `ray`).

A trial that crashes its process thus affects neither other trials nor the store. A worker receives its
job and sends its reports over one socket:

    python -P -m experiment_runner.processes.children experiment_runner.executors.workers DESCRIPTOR

On a cluster, too, only this process writes the store. Ray's own retries are disabled: they would repeat a
trial from its start, and report again episodes that are already stored. Instead, a lost trial continues
from its checkpoint, see `experiment_runner.executors.dispatcher`.

Jobs and reports cross the cluster as bytes, in our own encoding. Ray itself uses pickle for other data,
such as its exceptions, so the members of a cluster must trust each other.
"""

from __future__ import annotations

import contextlib
import logging
import re
import select
import signal
import socket
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from queue import SimpleQueue
from threading import Thread
from types import FrameType, TracebackType
from typing import Any, Final, NamedTuple, NoReturn, Self

from experiment_runner.executors.interrupts import Interrupts, Terminated
from experiment_runner.executors.job import REPORTS, Ended, Job, Lost, decode, encode, unpack, unpacker
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
from glue.errors import ConfigError, ExperimentError, described
from glue.installed import needing

_MODULE: Final = "experiment_runner.executors.workers"
_CHUNK: Final = 2**18
_JOBS: Final = {Job.__name__: Job}


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
        job = decode(value, _JOBS)
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


_BATCH_SECONDS: Final = 0.1
_CONNECT_SECONDS: Final = 5.0
_ADDRESS: Final = re.compile(r"(?P<host>.+):(?P<port>\d{1,5})")


Work = Callable[[Any, Callable[[object], None]], None]


def _trial(value: Any, send: Callable[[object], None]) -> None:
    run_job(decode(value, _JOBS), send)


class RayExecutor:
    """Executor on the processors of a cluster; see `experiment_runner.executors.dispatcher.Executor`.

    Args:
        address: the address of the cluster; None for the one that Ray finds, or else one on this machine.
        size: maximum number of concurrent trials; None for the cluster's number of processors at the start.
        work: called in a worker with the value of an encoded job, and a function that sends a report.
        reports: types of its reports by name.

    Raises:
        ConfigError: Ray is not installed.
    """

    def __init__(
        self,
        address: str | None,
        size: int | None,
        work: Work = _trial,
        reports: Mapping[str, type[Any]] = REPORTS,
    ) -> None:
        with needing("ray", "running on Ray needs it"):
            import ray
        self._ray: Any = ray
        self._work = work
        self._reports = reports
        self._address = address
        self._asked = size
        self._running: dict[Any, str] = {}
        self.size: int = 0

    def start(self, job: Any) -> None:
        """Run a trial as a task that uses one processor."""
        task = self._ray.remote(num_cpus=1, max_retries=0)(_run)
        self._running[task.remote(encode(job), self._work)] = job.spec.id

    def receive(self, seconds: float) -> list[tuple[str, Any]]:
        """Return reports with the ids of their trials; wait at most `seconds`."""
        ready, _ = self._ray.wait(list(self._running), num_returns=1, timeout=seconds)
        received: list[tuple[str, Any]] = []
        for stream in ready:
            trial_id = self._running[stream]
            reports = self._read(stream)
            received += [(trial_id, report) for report in reports]
            if isinstance(reports[-1], (Ended, Lost)):
                del self._running[stream]
        return received

    def cancel(self, trial_id: str) -> None:
        """Kill the Ray worker of a trial."""
        for stream in [stream for stream, running in self._running.items() if running == trial_id]:
            del self._running[stream]
            self._cancel(stream)

    def stop(self) -> None:
        """Do nothing: trials are not given time to end, and will continue from their newest checkpoints."""

    def _read(self, stream: Any) -> list[Any]:
        try:
            data: bytes = self._ray.get(next(stream))
        except (self._ray.exceptions.RayError, StopIteration) as error:
            self._cancel(stream)  # in case it is still running
            why = str(error).strip().partition("\n")[0]
            return [Lost(f"its Ray worker was lost: {type(error).__name__}: {why}")]
        return [decode(value, self._reports) for value in unpack(data)]

    def _cancel(self, stream: Any) -> None:
        with contextlib.suppress(self._ray.exceptions.RayError):
            self._ray.cancel(stream, force=True)

    def __enter__(self) -> Self:
        if self._address is not None:
            _check_cluster(self._address)
        try:
            self._ray.init(address=self._address, logging_level=logging.ERROR)
        except (ConnectionError, ValueError, RuntimeError) as error:
            reason = str(error).strip().partition("\n")[0]
            raise ExperimentError(f"cannot use Ray: {reason}") from error
        self.size = self._asked or max(1, int(self._ray.cluster_resources().get("CPU", 1)))
        return self

    def __exit__(self, *_: object) -> None:
        for stream in self._running:
            self._cancel(stream)
        self._ray.shutdown()


def _run(data: bytes, work: Work) -> Iterator[bytes]:
    """Do the work of an encoded job in a Ray worker, yielding its encoded reports in batches.

    It is done in a thread, so that Ray creates at most ten objects per second, not one per episode.
    """
    [value] = unpack(data)
    reports: SimpleQueue[object] = SimpleQueue()

    def run() -> None:
        try:
            work(value, reports.put)
        except BaseException as error:  # a job of another version of the program, for instance
            reports.put(Ended(described(error)))

    Thread(target=run, daemon=True).start()
    ended = False
    while not ended:
        batch = [reports.get()]
        time.sleep(_BATCH_SECONDS)
        while not reports.empty():
            batch.append(reports.get())
        ended = isinstance(batch[-1], Ended)
        yield b"".join(map(encode, batch))


def parse_address(address: str) -> tuple[str, int]:
    """Return the host and port of a cluster.

    Raises:
        ConfigError: it does not have the form HOST:PORT.
    """
    match = _ADDRESS.fullmatch(address)
    if match is None or not 1 <= int(match["port"]) <= 65535:
        raise ConfigError(f"{address!r:.80} is not the address of a Ray cluster: write HOST:PORT")
    return match["host"].strip("[]"), int(match["port"])


def _check_cluster(address: str) -> None:
    """Check that a program listens at the address; Ray itself would keep trying for minutes."""
    try:
        socket.create_connection(parse_address(address), _CONNECT_SECONDS).close()
    except OSError as error:
        reason = error.strerror or str(error)
        raise ExperimentError(f"there is no Ray cluster at {address}: {reason}") from error


if __name__ == "__main__":
    main()
