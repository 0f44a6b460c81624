"""An entrant's side of a season: what `season.toml` holds, requests to the season's page, and an attempt.

The page is a server of others: its answers are bounded in size, and never lead to another address. Requests
are signed with the entrant's key (see `glue.keys.requests`). The attempt itself is played at a hub, as any
session is.
"""

from __future__ import annotations

import hashlib
import io
import json
import os
import re
import tomllib
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Any, Final, Literal
from urllib.parse import urlsplit

import msgspec

from glue.client.target import OwnKey, Target
from glue.console import one_line
from glue.errors import ConfigError, GlueError
from glue.files import descriptor_of
from glue.keys.certificates import KeyPair, decode, encode, read_pair, read_public
from glue.keys.files import read_own
from glue.keys.requests import signed
from glue.system import clock
from glue.system.web import Answer, NoAnswer, ask, is_address

PREFIX: Final = "/season/api/"
"""Path of the page below which programs ask."""

STARTED: Final = 409
"""Status of the answer to a request that was signed for another start of the page."""

SEASON_FILE: Final = "season.toml"

_SECONDS: Final = 60.0
"""Time for the page to answer."""

_UPLOAD_SECONDS: Final = 3600.0
"""Time to send an image, and for the season to check it and load it."""

_MOST_SHOWN: Final = 300
_MOST_BYTES_OF_FILE: Final = 2**16
_POLL_SECONDS: Final = 1.0
_LONGEST_POLL: Final = 10.0
"""Seconds between two questions of a program far back in the queue; it counts as gone after 15."""

_PATIENCE_SECONDS: Final = 600.0
"""Time for which a page that cannot answer now is asked again: it may be restarted."""

_EVERYWHERE: Final = re.compile(r"(?<=//)(0\.0\.0\.0|\[::\]|\*)(?=:)")
"""The host of a hub that listens on every address of its machine."""

_TOKEN: Final = re.compile(r"[\w.~+/=-]{1,200}", re.ASCII)

Reply = Mapping[str, Any]
File = io.BytesIO | io.BufferedReader

Serve = Callable[[Target, Callable[[], bool]], None]
"""Plays a trial: joins a hub, and returns when it says goodbye, or cannot be reached for some seconds. The
other argument returns whether the trial is still being played; it asks the page, which takes a moment."""


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


class Membership(msgspec.Struct, frozen=True):
    """The data of an entrant of a season: the contents of its `season.toml`.

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
        values = {name: getattr(self, name) for name in self.__struct_fields__} | {"key": self.key.name}
        # A JSON string in ASCII is one of TOML.
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
        return msgspec.convert(found, Membership, dec_hook=lambda _, name: path.parent / str(name))
    except FileNotFoundError:
        raise ConfigError(f"there is no {path}: {hint}", settings=("season",)) from None
    except (msgspec.ValidationError, ValueError, RecursionError) as error:
        raise ConfigError(f"{path}: {one_line(str(error), _MOST_SHOWN)}; {hint}") from None


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
            # Without what follows the path, such as the token in the address of a row.
            self.url: str = f"{parts.scheme}://{parts.netloc}{parts.path}".rstrip("/")
            usable = is_address(self.url)
        except ValueError:
            usable = False
        if not usable:
            raise ConfigError(f"{url!r:.120} is not the address of a page, such as https://season.example")
        host = parts.hostname or ""
        self.host: str = f"[{host}]" if ":" in host else host
        self._start = ""  # as the page calls it; empty if that is not known

    def ask(
        self,
        method: str,
        what: str,
        body: Reply | File | None = None,
        pair: KeyPair | None = None,
        entrant: str = "",
        seconds: float = _SECONDS,
    ) -> Reply:
        """Return the answer to a request.

        Args:
            method: of HTTP.
            what: the last part of its path, such as `attempt`.
            body: sent as JSON; or a whole file.
            pair: keys to sign with; None not to sign.
            entrant: name of the sender.
            seconds: for the whole exchange.

        Raises:
            SeasonRefused: it is refused.
            SeasonBusy: the page cannot be reached, or asks to wait.
        """
        content = io.BytesIO(json.dumps(body or {}).encode()) if not isinstance(body, File) else body
        digest = hashlib.file_digest(content, "sha256").hexdigest()
        headers = {"Content-Length": str(content.seek(0, io.SEEK_END))}
        for _ in range(2):
            content.seek(0)
            if pair is not None:
                self._start = self._start or str(self.ask("GET", "start").get("start"))
                # A proxy may have taken off the beginning of the path.
                path, now = f"{PREFIX}{what}", clock.unix()
                headers |= signed(pair, entrant, method, path, digest, self._start, now)
            try:
                answer = ask(method, f"{self.url}{PREFIX}{what}", seconds, content, headers)
            except NoAnswer as error:
                raise SeasonBusy(f"the page {self.url} {error}") from None
            if answer.status != STARTED:
                break
            self._start = ""
        return self._understood(answer)

    def _understood(self, answer: Answer) -> Reply:
        reply, status = answer.json, answer.status
        if status == 200 and isinstance(reply, dict):
            return reply
        found = reply.get("error") if isinstance(reply, dict) else None
        text = found if isinstance(found, str) else answer.data.decode("utf-8", "replace")
        why = one_line(text, _MOST_SHOWN)
        if status in (429, 502, 503, 504):
            after = answer.headers.get("Retry-After", "")
            raise SeasonBusy(
                why or f"the page {self.url} answered {status}", float(after) if after.isdecimal() else 5.0
            )
        if 300 <= status < 400:  # such as a proxy that wants https
            place = one_line(answer.headers.get("Location", "another place"), _MOST_SHOWN)
            why = f"the page {self.url} leads to {place}: give the address that browsers open"
        elif found is None:
            why = f"the page {self.url} answered {status}, not as a season does: {why or 'nothing'}"
        raise SeasonRefused(why)


class Progress(msgspec.Struct, frozen=True):
    """The state of an attempt, as the page says it.

    Args:
        state: waiting, playing, verifying or over.
        attempt: its number.
        why: why nothing is played now; why it did not count or was forfeited.
        place: in the queue; on the board when it is over.
        trial: that is played, from 1.
        trials: in all.
        hub: URL of the hub where the trial is played; None if the season plays it, with an image.
        session: name of the session there.
        image: whether an image of the entrant plays it, or has.
        outcome: of an attempt that is over: verified, forfeited, ours or withdrawn.
        score: None if it is not told.
        low, high: the interval on the board, of the attempts that count.
        of: number of those that have a place.
        left: attempts left.
        returns: when new ones come.
    """

    state: Literal["waiting", "playing", "verifying", "over"]
    attempt: int
    why: str = ""
    place: int | None = None
    trial: int = 0
    trials: int = 0
    hub: str | None = None
    session: str = ""
    image: bool = False
    outcome: str = "verified"
    score: float | None = None
    low: float | None = None
    high: float | None = None
    of: int = 0
    left: int | None = None
    returns: str | None = None

    def __str__(self) -> str:
        """Return it as a line for people."""
        match self.state:
            case "waiting" if self.why:
                text = f"waits, and nothing is played now: {self.why}"
            case "waiting":
                text = f"waits, place {self.place} in the queue"
            case "playing":
                text = f"is played, trial {self.trial} of {self.trials}"
            case "verifying":
                text = "has been played, and is being verified"
            case _:
                text = "; ".join(["is over", *self._result()])
        return one_line(f"attempt {self.attempt}{' of your image' if self.image else ''} {text}")

    def _result(self) -> Iterator[str]:
        if self.outcome != "verified":
            yield self.outcome + (f" ({self.why})" if self.why else "")
        if self.score is not None:
            yield f"score {self.score:.10g}"
        if self.place is not None:
            known = self.low is not None and self.high is not None
            interval = f" (95 % interval of what counts: {self.low:.6g} to {self.high:.6g})" if known else ""
            yield f"place {self.place} of {self.of}{interval}"
        if self.left is not None:
            yield f"attempts left: {self.left}" + (f", new ones at {self.returns}" if self.returns else "")


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

    def ask(self, what: str, body: Reply | None = None) -> Reply:
        """Return the answer to a signed request; arguments and errors are those of `Page.ask`."""
        return self._page.ask("POST", what, body, self._key.pair, self.membership.name)

    def submit(self, file: File) -> None:
        """Hand in an image, which plays the attempts from now on.

        Args:
            file: a tar of `docker save`.

        Raises:
            SeasonRefused, SeasonBusy: as `Page.ask`.
        """
        self._page.ask("PUT", "image", file, self._key.pair, self.membership.name, _UPLOAD_SECONDS)

    def play(self, serve: Serve | None, say: Callable[[str], None]) -> Progress:
        """Play an attempt: wait for its turn, play every trial, and return what the page says at its end.

        One that fails for a reason of the season's is followed by another, of which the page tells then.

        Args:
            serve: plays a trial; None if only an image can.
            say: shows a line.

        Raises:
            SeasonRefused: no attempt is granted now.
            SeasonBusy: the page has not answered for a long time.
        """
        reply, told = self._attempt(0, say), ""
        number = reply.attempt
        while reply.state != "over":
            if str(reply) != told:
                told = str(reply)
                say(told)
            if reply.image and serve is not None:
                say("the image that you have handed in plays your attempts, and not this program")
                serve = None
            if reply.hub is not None and serve is not None:
                hub = _EVERYWHERE.sub(self._page.host, reply.hub)
                serve(Target(hub, reply.session, self._key), partial(self._is_on, reply, say))
            self._sleep(min(max(_POLL_SECONDS, reply.place or 0), _LONGEST_POLL))
            reply = self._attempt(number, say)
        return reply

    def _is_on(self, played: Progress, say: Callable[[str], None]) -> bool:
        reply = self._attempt(played.attempt, say)
        return (reply.state, reply.attempt, reply.trial) == ("playing", played.attempt, played.trial)

    def _attempt(self, number: int, say: Callable[[str], None]) -> Progress:
        """Ask how an attempt goes, or for a new one if `number` is 0, until the page answers."""
        waited = 0.0
        while True:
            try:
                reply = self.ask("attempt", {"attempt": number})
                return msgspec.convert(reply, Progress)
            except SeasonBusy as error:
                seconds = max(error.seconds, _POLL_SECONDS)
                if waited + seconds > _PATIENCE_SECONDS:  # as when no attempt is left today
                    raise
                if not waited:
                    say(f"{error}; asking again")
                self._sleep(seconds)
                waited += seconds
            except msgspec.ValidationError as error:
                why = one_line(f"{error}: {reply}", _MOST_SHOWN)
                raise SeasonRefused(f"the page {self._page.url} answers with no attempt: {why}") from None


def join(page: Page, name: str, secret: Path, code: str = "", team: str = "") -> tuple[Membership, str]:
    """Enrol as an entrant; return its membership, and its pseudonym.

    Args:
        page: of the season.
        name: of the entrant.
        secret: file of its secret key.
        code: for enrolling; empty if none is needed.
        team: of the entrant; empty for none.

    Raises:
        ConfigError: the key cannot be read.
        SeasonRefused, SeasonBusy: as `Page.ask`.
    """
    pair = read_pair(secret)
    body = {"name": name, "key": encode(pair.public), "code": code, "team": team}
    reply = page.ask("POST", "join", body, pair, name)
    hub_key, token, alias = (reply.get(field) for field in ("hub_key", "token", "alias"))
    try:
        decode(hub_key := str(hub_key))
    except ValueError:
        raise SeasonRefused(f"the page {page.url} answers without the key of its hubs") from None
    if not _TOKEN.fullmatch(token := str(token)):
        raise SeasonRefused(f"the page {page.url} answers with a token that no address can hold")
    return Membership(page.url, name, secret, hub_key, token), one_line(str(alias))
