"""Entrants in containers: a new container, which is a jail, for each trial of a task.

The engine is Docker's, or any other that offers Docker's API at a Unix socket, as podman does; the
environment variable DOCKER_HOST gives its address.
"""

from __future__ import annotations

import errno
import os
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from functools import cached_property
from pathlib import Path
from typing import Any, Final

from docker.errors import APIError, DockerException, ImageNotFound, NotFound
from requests.exceptions import RequestException

import docker
from experiment_runner.competition.jail import LABEL, check_engine, check_image, jail, user_of
from experiment_runner.competition.remover import MODULE as REMOVER
from experiment_runner.competition.settings import Entrant, Limits
from experiment_runner.competition.starting import SOCKET, Launch
from experiment_runner.meeting.watchdog import spawn
from experiment_runner.store.layout import write_flushed
from glue.console import say
from glue.errors import ConfigError, ExperimentError

_UNIX: Final = "unix://"
_DOCKER: Final = f"{_UNIX}/var/run/docker.sock"

_NOT_ALLOWED: Final = os.strerror(errno.EACCES)

_SIGNALLED: Final = 128
"""The exit status for signal 0."""

_BYTES_PER_SECOND: Final = 2**20
"""Rate at which the output of a container is read. Measured: a container that prints without end then costs
the engine 0.02 of a core; without this limit, with its logs in files, a whole core."""

_LAST_WORDS_SECONDS: Final = 3.0
"""Time to wait for the output of a container that has ended."""


class Containers:
    """Starts entrants that have an image.

    Args:
        warn: shows a line about an image that can take part but should be improved.
    """

    def __init__(self, warn: Callable[[str], None] = say) -> None:
        self._warn = warn

    def check(self, entrant: Entrant) -> None:
        """Check that the image is on this machine and can be jailed.

        Raises:
            ConfigError: the image is missing or unsuitable, or there is no engine that can hold a jail.
        """
        warning = check_image(str(entrant.image), self._image(entrant))
        if warning is not None:
            self._warn(f"{entrant.name}: {warning}")

    def start(self, entrant: Entrant, limits: Limits, launch: Launch) -> Container:
        """Start the image in a jail of its own.

        Raises:
            ConfigError: as `check`.
            ExperimentError: the engine cannot start it.
        """
        user, _ = user_of(self._image(entrant).get("User") or "")
        # The container's user may be unprivileged; the parent folder keeps out other users of this machine.
        launch.folder.chmod(0o711)
        (launch.folder / SOCKET).chmod(0o666)
        with _asking(f"start a container for {entrant.name}"):
            settings = {"Image": entrant.image, **jail(limits, launch, user, self._podman)}
            made = self._engine.containers.get(self._engine.api.create_container_from_config(settings)["Id"])
            try:
                container = Container(made, limits, launch.log, self._address.removeprefix(_UNIX))
                container.start()
            except BaseException:
                _remove(made)
                raise
        return container

    def sweep(self, run: str) -> None:
        """Remove the containers of a run that was killed, with their files.

        Raises:
            ConfigError: there is no engine.
            ExperimentError: the engine cannot remove them.
        """
        with _asking("remove the containers that are left over"):
            for container in self._engine.containers.list(all=True, filters={"label": f"{LABEL}={run}"}):
                _remove(container)

    def _image(self, entrant: Entrant) -> Mapping[str, Any]:
        """Return the configuration of an entrant's image."""
        engine = self._engine
        with _asking(f"look at the image {entrant.image}"):
            try:
                settings: Mapping[str, Any] = engine.images.get(entrant.image).attrs["Config"]
            except ImageNotFound:
                raise ConfigError(
                    f"{entrant.name}: the image {entrant.image} is not on this machine: bring it with docker "
                    "pull, docker load or docker build"
                ) from None
        return settings

    @property
    def _address(self) -> str:
        return os.environ.get("DOCKER_HOST") or _DOCKER

    @cached_property
    def _podman(self) -> bool:
        with _asking("say what it is"):
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
            raise ConfigError(
                f"no container engine answers at {address}: start Docker (systemctl start docker), or set "
                f"DOCKER_HOST to podman's socket; {_in_short(error)}"
            ) from None
        check_engine(found, address)
        return engine


class Container:
    """An entrant's container, for one trial of a task.

    Args:
        container: as the engine made it.
        limits: of the competition.
        log: the file that receives its output, once it is stopped.
        address: path of the engine's socket.

    Attributes:
        log: as given.
        reason: how it ended without being stopped; None until then. A container counts as ended once the
            system has killed one of its processes for lack of memory, even if others survive.
    """

    def __init__(self, container: Any, limits: Limits, log: Path, address: str) -> None:
        self.log = log
        self.reason: str | None = None
        self._container = container
        self._memory = limits.memory
        self._printed = _Printed(container.attach(stream=True), limits.log)
        # Not filtered by event type: podman names the types differently.
        self._events = container.client.api.events(
            since=int(time.time()), filters={"container": container.id}, decode=True
        )
        self._ended = threading.Event()
        self._stopped = False
        self._remover = spawn(REMOVER, [address, container.id])

    def start(self) -> None:
        """Start the container; it ends at once if its image cannot be run.

        Raises:
            APIError: the engine cannot start it.
        """
        self._printed.start()
        threading.Thread(target=self._watch, name="container", daemon=True).start()
        try:
            self._container.start()
        except APIError as error:
            if not error.is_client_error():
                self.stop()
                raise
            self._end(f"could not be started: {_in_short(error)}")

    def wait(self, seconds: float) -> bool:
        """Wait until it ends, at most `seconds`; return whether it has ended."""
        return self._ended.wait(seconds)

    def stop(self) -> None:
        """Kill its processes, keep their output, and remove it.

        Raises:
            ExperimentError: the engine cannot do so.
        """
        if self._stopped:
            return
        self._stopped = True
        with suppress(OSError):
            self._events.close()
        with _asking("stop a container"):
            with suppress(APIError):  # the container has ended
                self._container.kill()
            _remove(self._container)
        self._dismiss()
        with suppress(OSError):  # the disk is full: the log is not worth the trial
            write_flushed(self.log, self._printed.take())

    def _dismiss(self) -> None:
        """Kill the remover, which is no longer needed."""
        self._remover.kill()
        self._remover.communicate()

    def _watch(self) -> None:
        with suppress(OSError, DockerException):  # the engine is gone, or the container
            for event in self._events:
                if event["Action"] == "oom":
                    self._end(self._used_too_much())
                elif event["Action"] == "die" and not self._stopped:
                    self._container.reload()
                    state = self._container.attrs["State"]
                    memory = self._used_too_much() if state.get("OOMKilled") else None
                    self._end(memory or _how_it_ended(int(state["ExitCode"])))

    def _end(self, reason: str) -> None:
        self.reason = self.reason or reason
        self._ended.set()

    def _used_too_much(self) -> str:
        return f"used more than {self._memory / 2**20:g} MiB of memory"


class _Printed(threading.Thread):
    """Keeps the last output of a container.

    It reads no faster than an honest program writes. The engine, which passes the output on, would otherwise
    spend a whole core on a program that prints without end; with this limit, such a program has to wait.

    Args:
        stream: the container's output; closed by `take`.
        size: number of bytes to keep.
    """

    def __init__(self, stream: Any, size: int) -> None:
        super().__init__(name="printed", daemon=True)
        self._stream = stream
        self._size = size
        self._kept = bytearray()

    def run(self) -> None:
        """Read until the container ends."""
        with suppress(OSError):  # the engine is gone
            for chunk in self._stream:
                self._kept += chunk
                del self._kept[: -self._size]
                time.sleep(len(chunk) / _BYTES_PER_SECOND)

    def take(self) -> bytes:
        """Return the last output of a container that has ended."""
        self.join(_LAST_WORDS_SECONDS)
        with suppress(OSError):
            self._stream.close()
        return bytes(self._kept)


@contextmanager
def _asking(what: str) -> Iterator[None]:
    """Turn the engine's errors into one line.

    Raises:
        ExperimentError: the engine cannot do `what`.
    """
    try:
        yield
    except APIError as error:
        why = _in_short(error)
        remedy = "; make room with docker system prune" if "no space left" in why else ""
        raise ExperimentError(f"the container engine cannot {what}: {why}{remedy}") from None
    except (RequestException, OSError) as error:
        raise ExperimentError(
            f"the container engine does not answer: cannot {what}: {_in_short(error)}"
        ) from None


def _how_it_ended(status: int) -> str:
    if status > _SIGNALLED:
        return f"was killed by signal {status - _SIGNALLED}"
    return f"ended with status {status}"


def _remove(container: Any) -> None:
    with suppress(NotFound):
        container.remove(force=True, v=True)


def _in_short(error: Exception) -> str:
    text = str(getattr(error, "explanation", None) or error)
    return " ".join(text.split())[:300] or "no reason was given"
