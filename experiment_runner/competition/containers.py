"""Entrants in containers: a new container, which is a jail, for each trial of a task.

The engine is Docker's, or any other that offers Docker's API at a Unix socket, as podman does; the
environment variable DOCKER_HOST gives its address.

What the engine answers about an entrant's container is the entrant's affair, and ends in its forfeit. What it
says of itself, or that it says nothing, is waited for, and at last ends the trial without an outcome.
"""

from __future__ import annotations

import errno
import os
import threading
import time
from collections.abc import Callable, Collection
from contextlib import ExitStack, suppress
from datetime import datetime
from functools import cached_property
from pathlib import Path
from typing import Any, BinaryIO, Final, TypeVar

from docker.errors import APIError, DockerException, ImageNotFound, NotFound
from requests.exceptions import RequestException
from urllib3.exceptions import HTTPError

import docker
from experiment_runner.competition.jail import LABEL, check_engine, check_image, check_limits, jail, own_user
from experiment_runner.competition.launching import SOCKET, Launch, Launcher, Running
from experiment_runner.competition.remover import MODULE as REMOVER
from experiment_runner.competition.settings import Entrant, Limits
from experiment_runner.competition.usage import ControlGroup
from experiment_runner.processes.children import spawn
from experiment_runner.store.layout import write_flushed
from glue.console import say
from glue.errors import ConfigError, ExperimentError

_T = TypeVar("_T")

_UNIX: Final = "unix://"
_DOCKER: Final = f"{_UNIX}/var/run/docker.sock"

_NOT_ALLOWED: Final = os.strerror(errno.EACCES)

_PATIENCE_SECONDS: Final = 120.0
"""Seconds to wait for an engine that is away, or lacks something of this machine's."""

_AGAIN_SECONDS: Final = 1.0

_LACKS: Final = tuple(
    os.strerror(getattr(errno, name)).lower()
    for name in ("ENOSPC", "EDQUOT", "ENOMEM", "EMFILE", "ENFILE", "EAGAIN", "EIO")
)
"""Ends of answers in which an engine speaks of this machine, whatever it was asked to do."""

_REMOVED: Final = (404, 409)
"""Answers about a container that is gone, or is being removed."""

_SIGNALLED: Final = 128
"""The exit status for signal 0."""

_SHORT_ID: Final = 12

_BYTES_PER_SECOND: Final = 2**15
"""Rate at which the output of a container is read."""

_READS_PER_SECOND: Final = 50

_LAST_WORDS_SECONDS: Final = 10.0
"""Time to wait for the output of a container that has ended."""

_LATE_SECONDS: Final = 1.0
"""Time to wait for the news that a container that has ended had run out of memory: it may come second."""


class _Unreachable(ConfigError):
    """No engine answers."""


class Containers(Launcher):
    """Starts entrants that have an image."""

    def check(self, entrant: Entrant, limits: Limits) -> str:
        """Check that the image is on this machine and can be jailed; return its id.

        Raises:
            ConfigError: the image is missing or unsuitable, or there is no engine that can hold a jail.
            ExperimentError: the engine cannot look at it.
        """
        engine = self._engine

        def look() -> Any:
            check_limits(limits, engine.info()["NCPU"])
            return engine.images.get(entrant.id or entrant.image).attrs

        try:
            found = _ask(f"look at the image {entrant.image}", look)
        except ImageNotFound:
            raise ConfigError(_missing(entrant)) from None
        except APIError as error:
            raise ConfigError(f"the image {entrant.image} cannot be read: {_in_short(error)}") from None
        warning = check_image(str(entrant.image), found["Config"], found["Size"])
        if warning is not None and not entrant.id:
            say(f"{entrant.name}: {warning}")
        return str(found["Id"])

    def load(self, file: BinaryIO, repository: str) -> str:
        """Load an image that `season.images` has checked, under a name of ours, and return its id.

        Args:
            file: a tar of one image without names.
            repository: for the name, without which `docker image prune` would remove the image.

        Raises:
            ConfigError: there is no engine, or it does not take the file for an image, or only for one that
                cannot be jailed, which `tidy` removes.
            ExperimentError: the engine has no room.
        """
        engine = self._engine

        def load() -> Any:
            file.seek(0)
            return engine.images.load(file)

        try:
            (image,) = _ask("load an image", load)
            image.tag(repository, image.id.rpartition(":")[2][:_SHORT_ID])
            check_image("uploaded", image.attrs["Config"], 0)
        except (APIError, ImageNotFound, ValueError) as error:
            raise ConfigError(f"the engine does not take it for an image: {_in_short(error)}") from None
        return str(image.id)

    def tidy(self, repository: str, needed: Collection[str], until: datetime) -> None:
        """Remove images that were loaded, under this name and until then, and are not needed.

        Raises:
            ConfigError: there is no engine.
            ExperimentError: the engine cannot remove them.
        """
        engine = self._engine

        def remove() -> None:
            for image in engine.images.list(name=repository):
                loaded = image.attrs.get("Metadata", {}).get("LastTagTime")
                if image.id in needed or not loaded or datetime.fromisoformat(loaded) > until:
                    continue
                for tag in (tag for tag in image.tags if tag.startswith(f"{repository}:")):
                    with suppress(ImageNotFound):
                        engine.images.remove(tag)

        with suppress(APIError):  # a container still has it: another time
            _ask("remove images", remove)

    def start(self, entrant: Entrant, limits: Limits, launch: Launch) -> Running:
        """Start the image in a jail of its own.

        Raises:
            ConfigError, ExperimentError: the image is gone, or the engine can start nothing.
        """
        # The container's user may be unprivileged; the parent folder keeps out other users of this machine.
        launch.folder.chmod(0o711)
        (launch.folder / SOCKET).chmod(0o666)
        try:
            return _ask(f"start a container for {entrant.name}", lambda: self._start(entrant, limits, launch))
        except ImageNotFound:
            raise ExperimentError(_missing(entrant)) from None
        except APIError as error:
            return _NotStarted(launch.log, f"could not be started: {_in_short(error)}")

    def _start(self, entrant: Entrant, limits: Limits, launch: Launch) -> Running:
        with ExitStack() as held:
            user = held.enter_context(own_user())
            settings = {"Image": entrant.id or entrant.image, **jail(limits, launch, user, self._podman)}
            made = self._engine.containers.get(self._engine.api.create_container_from_config(settings)["Id"])
            try:
                container = Container(made, limits, launch.log, self._address.removeprefix(_UNIX), held)
                container.begin()
            except BaseException as error:
                with suppress(DockerException, OSError):  # the engine is gone: `sweep` removes it
                    _remove(made)
                if isinstance(error, NotFound) and str(made.id) in str(error):
                    raise ExperimentError("somebody removed a container before it could start") from None
                raise
            container.held = held.pop_all()
        return container

    def sweep(self, run: str) -> None:
        """Remove the containers of a run that was killed, with their files.

        Raises:
            ConfigError: there is no engine.
            ExperimentError: the engine cannot remove them.
        """

        def remove() -> None:
            for container in self._engine.containers.list(all=True, filters={"label": f"{LABEL}={run}"}):
                _remove(container)

        _ask("remove the containers that are left over", remove)

    @property
    def _address(self) -> str:
        return os.environ.get("DOCKER_HOST") or _DOCKER

    @cached_property
    def _podman(self) -> bool:
        parts = self._engine.version().get("Components") or []
        return any("podman" in str(part.get("Name")).lower() for part in parts)

    @cached_property
    def _engine(self) -> Any:
        """The engine's client."""
        address = self._address
        if not address.startswith(_UNIX):
            raise ConfigError(
                f"DOCKER_HOST is {address}, but a container reaches the hub through a directory of this "
                f"machine: its engine must be here too, as in DOCKER_HOST={_DOCKER}"
            )
        try:
            engine = docker.DockerClient(base_url=address)
            found = engine.info()
        except (DockerException, RequestException, OSError) as error:
            if _NOT_ALLOWED in str(error):
                raise ConfigError(
                    f"the container engine at {address} does not let this user in: join its group (usermod "
                    "--append --groups docker USER, and log in again), or set DOCKER_HOST to the socket of "
                    "a rootless one"
                ) from None
            raise _Unreachable(
                f"no container engine answers at {address}: start Docker (systemctl start docker), or set "
                f"DOCKER_HOST to podman's socket; {_in_short(error)}"
            ) from None
        check_engine(found, address)
        return engine


class Container(Running):
    """An entrant's container, for one trial of a task.

    Args:
        container: as the engine made it, not started yet.
        limits: of the competition.
        log: the file that receives its output, once it is stopped.
        address: path of the engine's socket.
        held: receives what is released when the container is gone.

    Attributes:
        log: as given.
        reason: how it ended without being stopped; None until then. A container counts as ended once the
            system has killed one of its processes for lack of memory, even if others survive.
        lost: why the engine, or somebody at it, has ended it; None if nothing has.
        offence: as `reason`, if it used too much memory.
        held: as given; what the container itself releases.
    """

    def __init__(self, container: Any, limits: Limits, log: Path, address: str, held: ExitStack) -> None:
        super().__init__()
        self.log = log
        self.held = held
        self._container = container
        self._memory = limits.memory
        self._stopped = False
        self._group: ControlGroup | None = None
        self._printed = _Printed(container.attach(stream=True), limits.log)
        # Not filtered by event type: podman names the types differently.
        self._events = container.client.api.events(
            since=int(time.time()), filters={"container": container.id}, decode=True
        )
        self._remover = spawn(REMOVER, [address, container.id])
        held.callback(self._dismiss)
        self._printed.start()
        self._watcher = threading.Thread(target=self._watch, name="container", daemon=True)
        self._watcher.start()

    def stop(self) -> None:
        """Kill its processes, keep their output, and remove it.

        Raises:
            ExperimentError: the engine cannot do so.
        """
        if self._stopped:
            return
        self._stopped = True

        if self._group is not None:
            self._group.read()

        def kill() -> None:
            with suppress(APIError):  # the container has ended
                self._container.kill()
            if not self._over.is_set():
                self._watcher.join(_LAST_WORDS_SECONDS)  # news of its memory may be under way
            _remove(self._container)

        try:
            _ask("remove a container", kill)
        except APIError as error:
            raise ExperimentError(
                f"the container engine cannot remove a container: {_in_short(error)}"
            ) from None
        self.held.close()
        with suppress(OSError, HTTPError):
            self._events.close()
        with suppress(OSError):  # the disk is full: the log is not worth the trial
            write_flushed(self.log, self._printed.take())

    @property
    def processor(self) -> float | None:
        """Seconds that it has used of all processors so far; None if this machine does not show it."""
        if self._group is None:
            return None
        self._group.read()
        return self._group.processor

    @property
    def peak(self) -> int | None:
        """The most bytes of memory that it had used at once when `processor` was last asked for."""
        return None if self._group is None else self._group.peak

    def begin(self) -> None:
        """Start it.

        Raises:
            APIError: the engine cannot.
        """
        self._container.start()
        self._group = ControlGroup(self._container.id)

    def _dismiss(self) -> None:
        """Kill the remover, which is no longer needed."""
        self._remover.kill()
        self._remover.communicate()

    def _watch(self) -> None:
        with suppress(OSError, DockerException, HTTPError):  # the engine is gone
            for event in self._events:
                if event["Action"] == "oom":
                    self._offend(f"used more than {self._memory / 2**20:g} MiB of memory")
                elif event["Action"] == "kill" and not self._stopped:
                    self._lose("the container engine was told to kill the container, or to end")
                elif event["Action"] == "die":
                    if self._stopped:
                        break
                    self._container.reload()
                    status = int(self._container.attrs["State"]["ExitCode"])
                    how = f"ended with status {status}"
                    if status > _SIGNALLED:  # the container's init makes it of a signal, but so can a program
                        how += f", as if by signal {status - _SIGNALLED}"
                    late = threading.Timer(_LATE_SECONDS, self._end, [how])
                    late.daemon = True
                    late.start()
        if not self._stopped:
            self._lose("the container engine went away")


class _NotStarted(Running):
    """A container that the engine could not make or start."""

    def __init__(self, log: Path, reason: str) -> None:
        super().__init__()
        self.reason = reason
        self._over.set()
        with suppress(OSError):
            write_flushed(log, f"{reason}\n")


class _Printed(threading.Thread):
    """Keeps the last output of a container.

    The engine, which passes the output on, spends its own time on each piece that a program prints, however
    small. So little is read at a time, and seldom: what waits in the engine comes in one piece, and a program
    that prints without end has to wait. Once it has ended, the rest is read without a pause.

    Args:
        stream: the container's output; closed by `take`.
        size: number of bytes to keep.
    """

    def __init__(self, stream: Any, size: int) -> None:
        super().__init__(name="printed", daemon=True)
        self._stream = stream
        self._size = size
        self._kept = bytearray()
        self._over = threading.Event()

    def run(self) -> None:
        """Read until the container ends."""
        with suppress(OSError):  # the engine is gone
            for chunk in self._stream:
                self._kept += chunk
                del self._kept[: -self._size]
                self._over.wait(1 / _READS_PER_SECOND + len(chunk) / _BYTES_PER_SECOND)

    def take(self) -> bytes:
        """Return the last output of a container that has ended."""
        self._over.set()
        self.join(_LAST_WORDS_SECONDS)
        with suppress(OSError):
            self._stream.close()
        return bytes(self._kept)


def _ask(what: str, ask: Callable[[], _T]) -> _T:
    """Return the engine's answer; wait if it does not answer, or lacks something of this machine's.

    Raises:
        APIError: its answer, which is about what it was asked for.
        ExperimentError: it remained unable to answer.
    """
    until = time.monotonic() + _PATIENCE_SECONDS
    while True:
        try:
            return ask()
        except APIError as error:
            why = _in_short(error)
            if not why.lower().removesuffix(": unknown").endswith(_LACKS):
                raise
            if _LACKS[0] in why.lower():
                why += "; make room with docker system prune"
        except (_Unreachable, RequestException, HTTPError, OSError) as error:
            why = f"it does not answer: {_in_short(error)}"
        if time.monotonic() > until:
            raise ExperimentError(f"the container engine cannot {what}: {why}")
        time.sleep(_AGAIN_SECONDS)


def _missing(entrant: Entrant) -> str:
    what = f"the image {entrant.image}"
    if entrant.id:
        what += f" with which it was admitted, {entrant.id},"
    return f"{what} is not on this machine: bring it with docker pull, docker load or docker build"


def _remove(container: Any) -> None:
    try:
        container.remove(force=True, v=True)
    except APIError as error:
        if error.status_code not in _REMOVED:
            raise


def _in_short(error: Exception) -> str:
    text = str(getattr(error, "explanation", None) or error)
    return " ".join(text.split())[:300] or "no reason was given"
