"""Run trials on a Ray cluster (extra `ray`). Only this process writes the store.

Ray's own retries are disabled: they would repeat a trial from its start, and report again episodes that are
already stored. Instead, a lost trial continues from its checkpoint, see
`experiment_runner.executors.dispatcher`.

Jobs and reports cross the cluster as bytes, in our own encoding. Ray itself uses pickle for other data, such
as its exceptions, so the members of a cluster must trust each other.
"""

from __future__ import annotations

import contextlib
import logging
import re
import socket
import time
from collections.abc import Callable, Iterator, Mapping
from queue import SimpleQueue
from threading import Thread
from typing import Any, Final, Self

from experiment_runner.executors.job import (
    REPORTS,
    Ended,
    Lost,
    decode,
    decode_job,
    encode,
    unpack,
)
from experiment_runner.executors.trial import run_job
from glue.errors import ConfigError, ExperimentError

_BATCH_SECONDS: Final = 0.1
_CONNECT_SECONDS: Final = 5.0
_ADDRESS: Final = re.compile(r"(?P<host>.+):(?P<port>\d{1,5})")


Work = Callable[[Any, Callable[[object], None]], None]


def _trial(value: Any, send: Callable[[object], None]) -> None:
    run_job(decode_job(value), send)


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
        self._ray = _import_ray()
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
    Thread(target=work, args=(value, reports.put), daemon=True).start()
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


def _import_ray() -> Any:
    try:
        import ray
    except ImportError:
        raise ConfigError("running on Ray needs it: pip install 'glue-rl[ray]'") from None
    return ray
