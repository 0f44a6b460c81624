"""The control socket of a season's server: `control` in the directory of the run, for its owner alone.

A client sends one request, a JSON object on a line, and receives one reply on a line: `{"ok": true, ...}`, or
`{"ok": false, "error": TEXT}`, with `retry_after` in seconds if the request may succeed later.
"""

from __future__ import annotations

import json
import os
import selectors
import socket
import time
import traceback
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, Final

import msgspec

from experiment_runner.competition.settings import Entrant
from experiment_runner.store.database import StorageError, reported
from glue.closing import Closing
from glue.errors import ExperimentError, GlueError

CONTROL: Final = "control"
"""Name of the socket in the directory of a run."""

Reply = dict[str, Any]

_MOST_BYTES: Final = 2**17
"""Maximum size of a request."""

_MOST_BYTES_OF_REPLY: Final = 2**22

_PATIENCE_SECONDS: Final = 5.0
"""Time for a client to send its request, and to read the reply."""


class NoServer(ExperimentError):
    """No server answers for this directory."""


class TryLater(ExperimentError):
    """A request is refused now, and may succeed later.

    Attributes:
        retry_after: in how many seconds.
    """

    def __init__(self, message: str, retry_after: float) -> None:
        super().__init__(message)
        self.retry_after = retry_after


class _Request(msgspec.Struct, tag_field="do", tag=str.lower, forbid_unknown_fields=True):
    pass


class Organise(_Request, tag="act"):
    """An act of the organiser; see `experiment_runner.competition.season.acts`.

    Args:
        act: its kind, as in the journal.
        subject: the entrant's name, the id of a trial, `*` for all entrants, or empty.
        why: the reason; the text of an announcement.
        number: the number of an attempt, or of attempts granted; 0 for none.
        admitted: of `add`, each new entrant, which can be started, with its id, and its pseudonym, which is
            empty if entrants have none.
    """

    act: str
    subject: str = ""
    why: str = ""
    number: int = 0
    admitted: tuple[tuple[Entrant, str], ...] = ()


class Enrol(_Request):
    """A stranger wants to take part.

    Args:
        name: by which it wants to be known.
        key: its public key.
        code: for a season with `enrol = "code"`.
        team: that it belongs to.
    """

    name: str
    key: str
    code: str = ""
    team: str = ""


class Attempt(_Request):
    """An entrant wants to play, or asks how its attempt goes.

    Args:
        entrant: its name.
        attempt: number of the attempt that it asks about; 0 for the one that waits or plays, or a new one.
    """

    entrant: str
    attempt: int = 0


class Key(_Request):
    """The public key with which an entrant's requests are signed is asked for."""

    entrant: str


class Withdraw(_Request):
    """An entrant takes an attempt off the board."""

    entrant: str
    attempt: int


class Submit(_Request):
    """An entrant has uploaded an image, which plays its attempts from now on.

    Args:
        entrant: its name.
        image: id of the image.
        name: what its owner calls it.
    """

    entrant: str
    image: str
    name: str


class Status(_Request):
    """How many attempts can be played and are, whether any are accepted, and why none is let play."""


Request = Organise | Enrol | Attempt | Key | Withdraw | Submit | Status

_DECODER: Final = msgspec.json.Decoder(Request, dec_hook=lambda kind, text: kind(text))  # of a path


class Door(Closing):
    """The server's end of the socket.

    Args:
        directory: of the run, whose lock the caller holds.
        clock: returns seconds.

    Raises:
        StorageError: the socket cannot be made.
    """

    def __init__(self, directory: Path, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._path = directory / CONTROL
        self._clients: dict[socket.socket, tuple[bytearray, float]] = {}
        """The bytes that each has sent, and the time by which its request has to be complete."""
        self._ready = selectors.DefaultSelector()
        self._listener = socket.socket(socket.AF_UNIX)
        with reported(f"cannot make {self._path}"), _short(directory) as short:
            self._path.unlink(missing_ok=True)  # of a server that was killed
            os.fchmod(self._listener.fileno(), 0o600)  # Linux gives this mode to the file
            self._listener.bind(short)
            self._listener.listen()
        self._listener.setblocking(False)
        self._ready.register(self._listener, selectors.EVENT_READ)

    def serve(self, answer: Callable[[Request], Reply], seconds: float) -> None:
        """Answer the requests that are there, or come within `seconds`.

        A `GlueError` from `answer` refuses the request.

        Raises:
            StorageError: from `answer`, after the request was refused.
        """
        for key, _ in self._ready.select(seconds):
            found = key.fileobj
            assert isinstance(found, socket.socket)
            if found is self._listener:
                self._accept()
            elif (line := self._read(found)) is not None:
                self._reply(found, answer, line)
        now = self._clock()
        for client in [client for client, (_, until) in self._clients.items() if now > until]:
            self._drop(client)

    def close(self) -> None:
        """Close the socket, and remove it."""
        for client in list(self._clients):
            self._drop(client)
        self._listener.close()
        self._ready.close()
        self._path.unlink(missing_ok=True)

    def _accept(self) -> None:
        with suppress(BlockingIOError, ConnectionError):
            client, _ = self._listener.accept()
            client.setblocking(False)
            self._clients[client] = bytearray(), self._clock() + _PATIENCE_SECONDS
            self._ready.register(client, selectors.EVENT_READ)

    def _read(self, client: socket.socket) -> bytes | None:
        """Return the request of a client, once it is complete."""
        received, _ = self._clients[client]
        data = b""
        with suppress(OSError):
            data = client.recv(_MOST_BYTES)
        received += data
        line, end, _ = received.partition(b"\n")
        if end and len(line) <= _MOST_BYTES:
            return bytes(line)
        if not data or len(received) > _MOST_BYTES:
            self._drop(client)
        return None

    def _reply(self, client: socket.socket, answer: Callable[[Request], Reply], line: bytes) -> None:
        failed = None
        try:
            reply = {"ok": True, **answer(_DECODER.decode(line))}
        except TryLater as error:
            reply = {"ok": False, "error": str(error), "retry_after": error.retry_after}
        except (GlueError, ValueError, RecursionError) as error:
            failed = error
            reply = {"ok": False, "error": str(error)}
        except Exception as error:  # a fault of ours ends one request, and nobody's attempt
            traceback.print_exception(error)
            reply = {"ok": False, "error": f"the server has a fault: {type(error).__name__}: {error}"}
        with suppress(OSError):  # it has not waited
            client.settimeout(_PATIENCE_SECONDS)
            client.sendall(json.dumps(reply).encode() + b"\n")
        self._drop(client)
        if isinstance(failed, StorageError):
            raise failed

    def _drop(self, client: socket.socket) -> None:
        del self._clients[client]
        self._ready.unregister(client)
        client.close()


def ask(directory: Path, request: Mapping[str, Any], seconds: float = 30.0) -> Reply:
    """Return the server's reply to a request.

    Args:
        directory: of the run.
        request: as the classes of this module, with `do`.
        seconds: to wait.

    Raises:
        NoServer: there is none, or it does not answer.
    """
    try:
        with _short(directory) as short, socket.socket(socket.AF_UNIX) as client:
            client.settimeout(seconds)
            client.connect(short)
            plain = msgspec.to_builtins(request, enc_hook=str)  # paths are texts
            client.sendall(json.dumps(plain).encode() + b"\n")  # what is no UTF-8 is refused there
            line = client.makefile("rb").readline(_MOST_BYTES_OF_REPLY)
            if not line.endswith(b"\n"):
                raise ConnectionError("its reply is not whole")
    except OSError as error:
        raise NoServer(f"no server answers in {directory}: {error.strerror or error}") from None
    reply: Reply = json.loads(line)
    return reply


@contextmanager
def _short(directory: Path) -> Iterator[str]:
    """Yield a path of the socket that is short, however long that of the directory is."""
    descriptor = os.open(directory, os.O_RDONLY | os.O_DIRECTORY)
    try:
        yield f"/proc/self/fd/{descriptor}/{CONTROL}"
    finally:
        os.close(descriptor)
