"""An entrant's side of a season: what `season.toml` holds, requests to the season's page, and an attempt.

The page is a server of others: its answers are bounded in size, and never lead to another address. Requests
are signed with the entrant's key (see `glue.keys.requests`). The attempt itself is played at a hub, as any
session is.
"""

from __future__ import annotations

import hashlib
import http.client
import io
import json
import os
import re
import tomllib
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Final, Protocol
from urllib.parse import urlsplit

from glue.client.target import OwnKey, Target
from glue.console import one_line
from glue.errors import ConfigError, GlueError
from glue.files import descriptor_of
from glue.keys.certificates import KeyPair, decode, encode, read_pair, read_public
from glue.keys.files import read_own
from glue.keys.requests import signed
from glue.system import clock

PREFIX: Final = "/season/api/"
"""Path of the page below which programs ask."""

SEASON_FILE: Final = "season.toml"

_KINDS: Final = {"http": http.client.HTTPConnection, "https": http.client.HTTPSConnection}
_SECONDS: Final = 60.0
"""Time for the page to answer, or to take the next part of a body."""

_MOST_BYTES: Final = 2**20
_MOST_SHOWN: Final = 300
_MOST_FAILURES: Final = 3
"""Attempts in a row that may fail for a reason of the season's."""

_MOST_BYTES_OF_FILE: Final = 2**16
_POLL_SECONDS: Final = 1.0
_LONGEST_POLL: Final = 10.0
"""Seconds between two questions of a program far back in the queue; it counts as gone after 15."""

_PATIENCE_SECONDS: Final = 600.0
"""Time for which a page that cannot answer now is asked again: it may be restarted."""

_EVERYWHERE: Final = re.compile(r"(?<=//)(0\.0\.0\.0|\[::\]|\*)(?=:)")
"""The host of a hub that listens on every address of its machine."""

_FIELDS: Final = ("page", "name", "key", "hub_key", "token")

Reply = Mapping[str, Any]
File = io.BytesIO | io.BufferedReader


class SeasonRefused(GlueError):
    """The season refuses what was asked for; the message says why."""


class SeasonBusy(GlueError):
    """The page cannot be asked now, or asks to wait.

    Args:
        message: what is wrong.
        seconds: to wait before asking again.
    """

    def __init__(self, message: str, seconds: float = 5.0) -> None:
        super().__init__(message)
        self.seconds = seconds


@dataclass(frozen=True, slots=True)
class Membership:
    """What an entrant knows of a season: the contents of its `season.toml`.

    Args:
        page: address of the season's page, such as `https://season.example`.
        name: of the entrant.
        key: file of the entrant's secret key.
        hub_key: public key of the season's hubs.
        token: opens the page for the entrant, with its own results.
    """

    page: str
    name: str
    key: Path
    hub_key: str
    token: str

    def write(self, path: Path) -> None:
        """Write a new file, which only this user can read.

        Raises:
            ConfigError: it exists, or cannot be written.
        """
        values = {**{name: getattr(self, name) for name in _FIELDS}, "key": self.key.name}
        # A JSON string is one of TOML.
        text = "".join(f"{name} = {json.dumps(value)}\n" for name, value in values.items())
        try:
            descriptor = descriptor_of(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
            with open(descriptor, "w", encoding="utf-8") as file:
                file.write(text)
        except OSError as error:
            raise ConfigError(f"cannot write {path}: {error.strerror}") from None


def read_membership(path: Path) -> Membership:
    """Return the contents of a `season.toml`.

    Raises:
        ConfigError: it cannot be read, or `glue-compete join` has not written it.
    """
    hint = "glue-compete join writes such a file"
    try:
        found = tomllib.loads(read_own(path, _MOST_BYTES_OF_FILE).decode())
    except FileNotFoundError:
        raise ConfigError(f"there is no {path}: {hint}", settings=("season",)) from None
    except (ValueError, RecursionError) as error:
        raise ConfigError(f"{path} is not TOML: {one_line(str(error), _MOST_SHOWN)}; {hint}") from None
    wrong = [name for name in _FIELDS if not isinstance(found.get(name), str)]
    if wrong:
        raise ConfigError(f"{path} lacks {', '.join(wrong)}, a string each; {hint}")
    values = {name: found[name] for name in _FIELDS}
    return Membership(**{**values, "key": path.parent / values["key"]})


class Page:
    """The page of a season.

    Args:
        url: its address.

    Raises:
        ConfigError: it is no such address.
    """

    def __init__(self, url: str) -> None:
        try:
            parts = urlsplit(url if "//" in url else f"http://{url}")
            usable = parts.scheme in _KINDS and url.isascii() and url.isprintable() and not parts.username
            self._host, self._port = parts.hostname or "", parts.port
        except ValueError:
            usable = False
        if not (usable and self._host):
            raise ConfigError(f"{url!r:.120} is not the address of a page, such as https://season.example")
        self._kind = _KINDS[parts.scheme]
        self.host: str = f"[{self._host}]" if ":" in self._host else self._host
        self.url: str = f"{parts.scheme}://{parts.netloc}{parts.path}".rstrip("/")
        self._path = parts.path.rstrip("/")

    def ask(
        self,
        method: str,
        what: str,
        body: Reply | File | None = None,
        pair: KeyPair | None = None,
        entrant: str = "",
    ) -> Reply:
        """Return the answer to a request.

        Args:
            method: of HTTP.
            what: the last part of its path, such as `attempt`.
            body: sent as JSON; or a whole file.
            pair: keys to sign with; None not to sign.
            entrant: name of the sender.

        Raises:
            SeasonRefused: it is refused.
            SeasonBusy: the page cannot be reached, or asks to wait.
        """
        content: File
        if body is None or isinstance(body, Mapping):
            content = io.BytesIO(json.dumps(body or {}).encode())
        else:
            content = body
        digest = hashlib.file_digest(content, "sha256").hexdigest()
        headers = {"Content-Length": str(content.seek(0, io.SEEK_END)), "Connection": "close"}
        content.seek(0)
        if pair is not None:
            # A proxy may have taken off the beginning of the path.
            headers |= signed(pair, entrant, method, f"{PREFIX}{what}", digest, clock.unix())
        connection = self._kind(self._host, self._port, timeout=_SECONDS)
        try:
            with suppress(BrokenPipeError, ConnectionResetError):  # it refuses the body, and says why
                connection.request(method, f"{self._path}{PREFIX}{what}", content, headers)
            response = connection.getresponse()
            data = response.read(_MOST_BYTES + 1)
        except (OSError, http.client.HTTPException) as error:
            raise SeasonBusy(f"the page {self.url} cannot be asked: {_reason(error)}") from None
        finally:
            connection.close()
        return self._understood(response.status, response.headers.get("Retry-After"), data)

    def _understood(self, status: int, retry_after: str | None, data: bytes) -> Reply:
        try:
            reply = json.loads(data) if len(data) <= _MOST_BYTES else None
        except (ValueError, RecursionError):
            reply = None
        if status == 200 and isinstance(reply, dict):
            return reply
        found = reply.get("error") if isinstance(reply, dict) else None
        why = one_line(found if isinstance(found, str) else data.decode("utf-8", "replace"), _MOST_SHOWN)
        if status in (429, 502, 503, 504):
            seconds = float(retry_after) if retry_after is not None and retry_after.isdecimal() else 5.0
            raise SeasonBusy(why or f"the page {self.url} answered {status}", seconds)
        if found is None:
            why = f"the page {self.url} answered {status}, not as a season does: {why or 'nothing'}"
        raise SeasonRefused(why)


class Serve(Protocol):
    """Plays a trial of an attempt."""

    def __call__(self, target: Target, on: Callable[[], bool]) -> None:
        """Join a hub, and return when it says goodbye, or cannot be reached for some seconds.

        Args:
            target: the hub, with session and keys.
            on: returns whether the trial is still being played; it asks the page, which takes a moment.
        """
        ...


class Season:
    """A season that this program has joined.

    Args:
        membership: of the entrant.
        sleep: waits for a number of seconds.

    Raises:
        ConfigError: a key cannot be read.
    """

    def __init__(self, membership: Membership, sleep: Callable[[float], None] = clock.sleep) -> None:
        self.membership = membership
        self._page = Page(membership.page)
        self._sleep = sleep
        pair = read_pair(membership.key)
        self._key = OwnKey(membership.key, pair, read_public(membership.hub_key))

    def ask(self, what: str, body: Reply | File | None = None, method: str = "POST") -> Reply:
        """Return the answer to a signed request; arguments and errors are those of `Page.ask`."""
        return self._page.ask(method, what, body, self._key.pair, self.membership.name)

    def play(self, serve: Serve, say: Callable[[str], None]) -> Reply:
        """Play an attempt: wait for its turn, play every trial, and return what the page says of it.

        Args:
            serve: plays a trial.
            say: shows a line.

        Raises:
            SeasonRefused: no attempt is granted now.
            SeasonBusy: the page has not answered for a long time.
        """
        for _ in range(_MOST_FAILURES):
            reply = self._follow(self._attempt(0, say), serve, say)
            if reply.get("outcome") != "ours":
                break
            say(f"{result(reply)}; it does not count")
        return reply

    def _follow(self, reply: Reply, serve: Serve, say: Callable[[str], None]) -> Reply:
        """Play the attempt that a reply is about; return the reply when it is over."""
        number, told = int(reply["attempt"]), ""
        while reply["state"] != "over":
            if reply["state"] == "playing":
                line = f"attempt {number}, trial {reply.get('trial')} of {reply.get('trials')}"
            elif reply["state"] == "waiting" and reply.get("why"):
                line = f"attempt {number} waits, and nothing is played now: {reply['why']}"
            elif reply["state"] == "waiting":
                line = f"attempt {number} waits, place {reply.get('place')} in the queue"
            else:
                line = f"attempt {number} has been played, and is being verified"
            if line != told:
                say(line)
                told = line
            if reply["state"] == "playing":
                trial = reply.get("trial")
                serve(self._target(reply), partial(self._is_on, number, trial, say))
            place = reply.get("place")
            self._sleep(min(place, _LONGEST_POLL) if isinstance(place, int) and place > 1 else _POLL_SECONDS)
            reply = self._attempt(number, say)
        return reply

    def _is_on(self, number: int, trial: object, say: Callable[[str], None]) -> bool:
        reply = self._attempt(number, say)
        return reply["state"] == "playing" and reply.get("trial") == trial

    def _attempt(self, number: int, say: Callable[[str], None]) -> Reply:
        """Ask how an attempt goes, or for a new one if `number` is 0, until the page answers."""
        waited = 0.0
        while True:
            try:
                reply = self.ask("attempt", {"attempt": number})
            except SeasonBusy as error:
                seconds = max(error.seconds, _POLL_SECONDS)
                if waited + seconds > _PATIENCE_SECONDS:  # as when no attempt is left today
                    raise
                if not waited:
                    say(f"{error}; asking again")
                self._sleep(seconds)
                waited += seconds
                continue
            if isinstance(reply.get("attempt"), int) and isinstance(reply.get("state"), str):
                return reply
            raise SeasonRefused(
                f"the page {self._page.url} answers with no attempt: {one_line(str(reply), 200)}"
            )

    def _target(self, reply: Reply) -> Target:
        hub = _EVERYWHERE.sub(self._page.host, str(reply.get("hub")))
        return Target(hub, str(reply.get("session")), self._key)


def join(page: Page, name: str, pair: KeyPair, code: str, team: str) -> Reply:
    """Enrol as an entrant; return the hub's public key, the entrant's token, and its alias.

    Raises:
        SeasonRefused, SeasonBusy: as `Page.ask`.
    """
    body = {"name": name, "key": encode(pair.public), "code": code, "team": team}
    reply = page.ask("POST", "join", body, pair, name)
    try:
        decode(str(reply.get("hub_key")))
    except ValueError:
        raise SeasonRefused(f"the page {page.url} answers without the key of its hubs") from None
    return reply


def result(reply: Reply) -> str:
    """Return what the page says of an attempt that is over, as a line for people."""
    parts = [f"attempt {reply.get('attempt')} is over"]
    if reply.get("outcome") not in (None, "verified"):
        parts.append(f"{reply['outcome']}" + (f" ({reply['why']})" if reply.get("why") else ""))
    if isinstance(reply.get("score"), int | float):
        score = f"score {reply['score']:.10g}"
        if isinstance(reply.get("low"), int | float) and isinstance(reply.get("high"), int | float):
            score += f" (95 % interval {reply['low']:.6g} to {reply['high']:.6g})"
        parts.append(score)
    if reply.get("place") is not None:
        parts.append(f"place {reply['place']} of {reply.get('of')}")
    if reply.get("left") is not None:
        left = f"attempts left: {reply['left']}"
        parts.append(f"{left}, new ones at {reply['returns']}" if reply.get("returns") else left)
    return one_line("; ".join(parts))


def _reason(error: Exception) -> str:
    return (error.strerror if isinstance(error, OSError) else None) or one_line(repr(error), 200)
