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
from collections.abc import Callable
from types import FrameType, TracebackType
from typing import Any, Final, NoReturn, Protocol, Self

from experiment_runner.children import FAREWELL_SECONDS, HURRIED_SECONDS, end, has_ended, how_it_ended, start
from experiment_runner.executors.job import (
    Ended,
    Lost,
    decode_job,
    decode_report,
    encode_job,
    encode_report,
    run_job,
    unpacker,
)
from experiment_runner.interrupts import Interrupts
from experiment_runner.plan import TrialSpec
from glue.commands import Terminated
from glue.errors import ExperimentError

__all__ = ["HasTrial", "LocalExecutor", "main", "serve"]

_MODULE: Final = "experiment_runner.executors.local"
_CHUNK: Final = 2**18


class HasTrial(Protocol):
    """What a worker is started for."""

    @property
    def spec(self) -> TrialSpec:
        """The trial."""
        ...


class LocalExecutor:
    """Worker processes; see `experiment_runner.executors.dispatch.Executor`.

    Args:
        size: maximum number of concurrent trials.
        module: what a worker runs; its `main` is one of `serve`.
        encode: returns a job as bytes.
        decode: returns the report from an unpacked value; a worker's last is `Ended`.
    """

    def __init__(
        self,
        size: int,
        module: str = _MODULE,
        encode: Callable[[Any], bytes] = encode_job,
        decode: Callable[[Any], Any] = decode_report,
    ) -> None:
        self.size = size
        self._module = module
        self._encode = encode
        self._decode = decode
        self._workers: dict[int, _Worker] = {}
        self._poll = select.poll()
        self._leaving: list[subprocess.Popen[bytes]] = []
        self._stopping = False

    def start(self, job: HasTrial) -> None:
        """Run a trial.

        Raises:
            ExperimentError: the process cannot be started.
        """
        worker = _Worker(job.spec.id, self._module, self._encode(job), self._decode)
        self._workers[worker.descriptor] = worker
        self._poll.register(worker.descriptor, select.POLLIN)

    def receive(self, seconds: float) -> list[tuple[str, Any]]:
        """Return reports with the ids of their trials, in order for each trial; wait at most `seconds`."""
        received: list[tuple[str, Any]] = []
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

    def __init__(self, trial_id: str, module: str, job: bytes, decode: Callable[[Any], Any]) -> None:
        self.trial_id = trial_id
        self._decode = decode
        self._socket, theirs = socket.socketpair()
        with theirs:
            self.process = start(module, [str(theirs.fileno())], pass_fds=[theirs.fileno()])
        self.descriptor = self._socket.fileno()
        self._unpacker = unpacker()
        with contextlib.suppress(OSError):  # it has ended already, as `read` will find
            self._socket.sendall(job)

    def read(self) -> list[Any]:
        """Return the reports received; the last is `Lost` if the worker has ended."""
        reports: list[Any] = []
        try:
            data = self._socket.recv(_CHUNK)
            self._unpacker.feed(data)
            reports += map(self._decode, self._unpacker)
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

    def run(job: Any, send: Callable[[bytes], None], interrupts: Interrupts) -> None:
        run_job(decode_job(job), lambda report: send(encode_report(report)), interrupts=interrupts)

    serve(run)


def serve(run: Callable[[Any, Callable[[bytes], None], Interrupts], None]) -> None:
    """Be a worker: receive one job over the socket whose descriptor is the first argument, and run it.

    Args:
        run: takes the unpacked job, what sends a report that is encoded, and what defers signals.
    """
    signal.signal(signal.SIGTERM, _terminate)
    with contextlib.suppress(Terminated), socket.socket(fileno=int(sys.argv[1])) as parent:

        def send(report: bytes) -> None:
            try:
                parent.sendall(report)
            except OSError:
                raise Terminated from None  # the experiment is over

        with Interrupts() as interrupts:
            run(_receive(parent), send, interrupts)


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
