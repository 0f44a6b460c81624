"""Requests of entrants' programs to a season, over HTTP: routes of the page's server, below `/season/api/`.

    POST join       name, key, code, team: enrol; answers with hub_key, token and alias
    POST attempt    attempt: how it goes, or a new one
    POST withdraw   attempt
    PUT  image      a tar of docker save
    GET  tasks      what is played, for trying it at home
    GET  start      start: a name of this start of the page, for which requests are signed

All requests but the last two are signed (see `glue.keys.requests`) and are passed on to the season's server,
which decides. Here is what protects it: signatures, sizes, and the rate of requests from one address and of
one entrant. A refusal is JSON, `{"error": TEXT}`, with 429 or 503 and Retry-After if it helps to wait.
"""

from __future__ import annotations

import asyncio
import errno
import hashlib
import io
import ipaddress
import json
import math
import os
import secrets
import shutil
import sys
import tempfile
import time
from collections.abc import Awaitable, Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import Any, BinaryIO, Final, cast

from starlette.concurrency import run_in_threadpool
from starlette.requests import ClientDisconnect, Request
from starlette.responses import JSONResponse, Response
from starlette.routing import BaseRoute, Route

from experiment_runner.competition.course import course_of
from experiment_runner.competition.season.control import NoServer, ask
from experiment_runner.competition.season.images import MODULE
from experiment_runner.competition.season.trying import tasks_of
from experiment_runner.competition.settings import load_competition
from experiment_runner.store.layout import COMPETITION_FILE
from glue.client.season import PREFIX, STARTED
from glue.errors import GlueError
from glue.keys.certificates import decode
from glue.keys.requests import DIGEST, ENTRANT, START, Once, Unsigned, check

_MOST_JSON: Final = 2**14
_MOST_UPLOADS: Final = 4
"""Images that are received at once."""

_JSON_SECONDS: Final = 10.0
_UPLOAD_SECONDS: Final = 900.0
"""Time for the body of a request to come."""

_GRACE_SECONDS: Final = 30.0
_LEAST_RATE: Final = 2**18
"""Bytes per second at which a body has to come after that time: who is slower would keep others waiting."""

_LOAD_SECONDS: Final = 900.0
"""Time to check an image, and for the engine to take it."""

_ROOM: Final = 3
"""Times its size that an image may take for a while: as it came, checked, and in the engine."""

_RESTART_SECONDS: Final = 10
_MOST_LETTERS: Final = 64
_NOBODY: Final = 32 * b"\xff"
"""A public key that belongs to nobody: nothing is signed with it."""

_MOST_LIMITED: Final = 10_000

_Answer = Mapping[str, Any]
_Endpoint = Callable[[Request], Awaitable[_Answer]]


class Denied(GlueError):
    """A request is not carried out.

    Args:
        message: why.
        status: of HTTP.
        seconds: after which to ask again; 0 if that does not help.
    """

    def __init__(self, message: str, status: int = 400, seconds: float = 0.0) -> None:
        super().__init__(message)
        self.status = status
        self.seconds = seconds


class Rate:
    """Limits how often each of many may do something: `burst` times at once, then `per_second`.

    Args:
        per_second: in the long run.
        burst: after a rest.
        clock: returns seconds.
    """

    def __init__(self, per_second: float, burst: int, clock: Callable[[], float]) -> None:
        self._interval = 1 / per_second
        self._ahead = burst * self._interval
        self._clock = clock
        self._used_until: dict[str, float] = {}

    def take(self, who: str) -> None:
        """Let `who` do it.

        Raises:
            Denied: it has done so too often.
        """
        now = self._clock()
        until = max(self._used_until.get(who, now), now) + self._interval
        if until > now + self._ahead:
            raise Denied("too many requests: ask less often", 429, until - now - self._ahead)
        if len(self._used_until) >= _MOST_LIMITED:
            self._used_until = {one: used for one, used in self._used_until.items() if used > now}
        self._used_until[who] = until

    def give_back(self, who: str) -> None:
        """Take back that `who` was let do it."""
        self._used_until[who] = self._used_until.get(who, 0.0) - self._interval


def routes(
    directory: Path, now: Callable[[], float] = time.time, proxy: str | None = None
) -> list[BaseRoute]:
    """Return the routes.

    Args:
        directory: of the season.
        now: returns seconds since 1970.
        proxy: as for `address_of`.
    """
    entrance = _Entrance(directory, now, proxy)
    return [
        Route(f"{PREFIX}join", _answering(entrance.join), methods=["POST"]),
        Route(f"{PREFIX}attempt", _answering(entrance.passing("attempt")), methods=["POST"]),
        Route(f"{PREFIX}withdraw", _answering(entrance.passing("withdraw")), methods=["POST"]),
        Route(f"{PREFIX}image", _answering(entrance.image), methods=["PUT"]),
        Route(f"{PREFIX}tasks", _answering(entrance.tasks), methods=["GET"]),
        Route(f"{PREFIX}start", _answering(entrance.start), methods=["GET"]),
    ]


def _answering(endpoint: _Endpoint) -> Callable[[Request], Awaitable[Response]]:
    async def answer(request: Request) -> Response:
        headers = {"Connection": "close"}
        try:
            return JSONResponse(await endpoint(request), headers=headers)
        except Denied as error:
            if error.seconds:
                headers["Retry-After"] = str(math.ceil(error.seconds))
            return JSONResponse({"error": str(error)}, error.status, headers)
        except Unsigned as error:
            return JSONResponse({"error": f"the request {error}"}, 403, headers)
        except ClientDisconnect:
            return Response(status_code=400)  # nobody reads it
        except GlueError as error:
            return JSONResponse({"error": str(error)}, 422, headers)

    return answer


class _Entrance:
    def __init__(self, directory: Path, now: Callable[[], float], proxy: str | None) -> None:
        self._directory = directory
        self._now = now
        self._address_of = partial(address_of, proxy=proxy)
        self._start = secrets.token_hex()
        self._once = Once()
        self._of_address = Rate(50, 500, now)
        self._joins = Rate(0.2, 60, now)
        self._of_entrant = Rate(2, 30, now)
        self._images = Rate(1 / 600, 5, now)
        self._uploading: set[str] = set()

    async def join(self, request: Request) -> _Answer:
        self._joins.take(self._address_of(request))
        body = await self._json(request)
        try:
            key = decode(str(body.get("key")))
        except ValueError:
            raise Denied("key is not a public key as glue-keys writes it") from None
        check(key, request.method, request.url.path, request.headers, self._now())
        return await self._ask({**body, "do": "enrol"})

    def passing(self, do: str) -> _Endpoint:
        """Return the endpoint that passes a signed request on as that of its entrant."""

        async def pass_on(request: Request) -> _Answer:
            entrant = await self._sender(request)
            return await self._ask({**await self._json(request), "do": do, "entrant": entrant})

        return pass_on

    async def tasks(self, request: Request) -> _Answer:
        self._of_address.take(self._address_of(request))
        # Not the journal, which anybody could make the page read, however long it is.
        file = self._directory / COMPETITION_FILE
        return tasks_of(await run_in_threadpool(partial(load_competition, file, follow=False)))

    async def start(self, request: Request) -> _Answer:
        self._of_address.take(self._address_of(request))
        return {"start": self._start}

    async def image(self, request: Request) -> _Answer:
        entrant = await self._sender(request)
        state = await run_in_threadpool(lambda: course_of(self._directory).state)
        season, known = state.season, state.entrants.get(entrant)
        if known is not None and known.excluded:
            raise Denied(f"{entrant} is excluded: {known.excluded}", 403)
        self._images.take(entrant)
        if not season.images:
            raise Denied("this season takes no images: play with glue-agent and season.toml", 403)
        size = request.headers.get("content-length", "")
        if not (size.isascii() and size.isdigit() and len(size) < _MOST_LETTERS):
            raise Denied("the request has no Content-Length", 411)
        if int(size) > season.most_bytes:
            most = f"{season.most_bytes / 2**20:g} MiB"
            raise Denied(f"the image has {int(size) / 2**20:.1f} MiB, and {most} are allowed", 413)
        with self._upload(entrant, int(size)) as file:
            await _received(request, file, int(size), _UPLOAD_SECONDS)
            found = await _loaded(file, season.most_bytes, self._directory)
        return await self._ask({"do": "submit", "entrant": entrant, "image": found, "name": found})

    @contextmanager
    def _upload(self, entrant: str, size: int) -> Iterator[BinaryIO]:
        """Yield a file for an image, which is gone afterwards, even if this process is killed."""
        if entrant in self._uploading:
            raise Denied("another image of this entrant is being received", 429, _RESTART_SECONDS)
        if len(self._uploading) >= _MOST_UPLOADS:
            self._images.give_back(entrant)  # not its fault
            raise Denied(f"{_MOST_UPLOADS} images are being received: try again", 503, _RESTART_SECONDS)
        self._uploading.add(entrant)
        try:
            if shutil.disk_usage(self._directory).free < _ROOM * size:
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            with tempfile.TemporaryFile(dir=self._directory) as file:
                yield cast("BinaryIO", file)
        except OSError as error:
            self._images.give_back(entrant)
            why = f"the season's machine cannot keep the image: {error.strerror}; tell its organiser"
            raise Denied(why, 503, 600) from None
        finally:
            self._uploading.discard(entrant)

    async def _sender(self, request: Request) -> str:
        """Return the entrant that has signed a request.

        Raises:
            Unsigned: no entrant has, or the request was received before.
            Denied: it names no entrant, asks too often, or the page was started since.
        """
        self._of_address.take(self._address_of(request))
        entrant: str = request.headers.get(ENTRANT, "")
        if not entrant or len(entrant) > _MOST_LETTERS or not entrant.isascii():
            raise Denied(f"the request needs the header {ENTRANT}: the name of the entrant", 403)
        key = (await self._ask({"do": "key", "entrant": entrant})).get("key")
        public = decode(key) if isinstance(key, str) else _NOBODY  # which names there are is not told
        now = self._now()
        check(public, request.method, request.url.path, request.headers, now)
        self._of_entrant.take(entrant)
        if request.headers.get(START) != self._start:  # an earlier page may have had it
            raise Denied("the request was signed for another start of the page: sign it anew", STARTED)
        self._once.remember(request.headers, now)
        return entrant

    async def _json(self, request: Request) -> Mapping[str, Any]:
        """Return the body of a request, if it is what was signed."""
        content = io.BytesIO()
        await _received(request, content, _MOST_JSON, _JSON_SECONDS)
        with suppress(ValueError, RecursionError):
            body = json.loads(content.getvalue())
            if isinstance(body, dict):
                return body
        raise Denied("the body is not a JSON object")

    async def _ask(self, question: Mapping[str, Any]) -> _Answer:
        """Return the answer of the season's server."""
        try:
            reply = await run_in_threadpool(ask, self._directory, question)
        except NoServer:
            message = "the season's server is not running: try again later, or tell its organiser"
            raise Denied(message, 503, _RESTART_SECONDS) from None
        if reply.pop("ok"):
            return dict(reply)
        seconds = float(reply.get("retry_after") or 0)
        raise Denied(str(reply["error"]), 429 if seconds else 403, seconds)


async def _received(request: Request, file: BinaryIO, most: int, seconds: float) -> None:
    """Write the body of a request to a file, if it is what was signed."""
    digest, count = hashlib.sha256(), 0
    try:
        loop = asyncio.get_running_loop()
        began = loop.time()
        async with asyncio.timeout(min(seconds, _GRACE_SECONDS)) as limit:
            async for piece in request.stream():
                count += len(piece)
                limit.reschedule(began + min(seconds, _GRACE_SECONDS + count / _LEAST_RATE))
                if count > most:
                    raise Denied(f"the body has more than {most:,} bytes", 413)
                digest.update(piece)
                await run_in_threadpool(file.write, piece)
        await run_in_threadpool(file.flush)
    except TimeoutError:
        raise Denied(
            f"the body has not come in time: {count:,} bytes in {loop.time() - began:.0f} s", 408
        ) from None
    if request.headers.get(DIGEST) != digest.hexdigest():
        raise Denied("the body is not the one that was signed: send it again")


async def _loaded(file: BinaryIO, most: int, directory: Path) -> str:
    """Load an image into the engine, in a separate process; return its id."""
    file.seek(0)
    command = (sys.executable, "-P", "-m", MODULE, str(most), str(directory))
    process = await asyncio.create_subprocess_exec(*command, stdin=file, stdout=asyncio.subprocess.PIPE)
    try:
        async with asyncio.timeout(_LOAD_SECONDS):
            printed, _ = await process.communicate()
    except TimeoutError:
        raise Denied("the image cannot be loaded in time: tell the season's organiser", 503, 600) from None
    finally:
        if process.returncode is None:
            process.kill()
    try:
        found = json.loads(printed)
    except ValueError:
        raise Denied("the image cannot be loaded: tell the season's organiser", 503, 600) from None
    if "error" in found:
        raise Denied(found["error"], 422)
    return str(found["id"])


def address_of(request: Request, proxy: str | None = None) -> str:
    """Return the address that limits count by; one network of IPv6 is one.

    A proxy, on this machine or at `proxy`, says whom it asks for, after whatever that one has sent itself.
    """
    host = request.client.host if request.client else ""
    try:
        address = _ip(host)
        is_proxy = address.is_loopback or str(address) == proxy
        if is_proxy and (passed := request.headers.getlist("x-forwarded-for")):
            address = _ip(passed[-1].rpartition(",")[2].strip())
    except ValueError:
        return host
    return str(ipaddress.ip_network((address, 64), strict=False) if address.version == 6 else address)


def _ip(text: str) -> ipaddress.IPv4Address | ipaddress.IPv6Address:
    """Return an address; that of IPv4 if a socket of IPv6 has it, or they would all be in one network."""
    address = ipaddress.ip_address(text)
    return (address.ipv4_mapped or address) if isinstance(address, ipaddress.IPv6Address) else address
