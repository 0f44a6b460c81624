"""Access control of the page's server, and the security headers of its responses.

A page of another site that is open in the same browser can send requests to this server and, with a name
that points to 127.0.0.1, even read the responses. So Host and Origin are checked on every request of every
method (Ray's dashboard got this wrong: CVE-2025-62593), and nothing is answered without the token, which a
browser exchanges for a cookie that no script can read and no other site can make it send.
"""

from __future__ import annotations

import hmac
import ipaddress
import secrets
import socket
from http.cookies import CookieError, SimpleCookie
from typing import Final
from urllib.parse import urlsplit

from starlette.datastructures import Headers, MutableHeaders
from starlette.requests import Request
from starlette.responses import PlainTextResponse, RedirectResponse, Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

ADMIT: Final = "admit"
"""Key in a request's state of a function to call once the request has shown the cookie."""

HEADERS: Final = {
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self'; "
    "img-src 'self' blob: data:; connect-src 'self'; base-uri 'none'; "
    "form-action 'none'; frame-ancestors 'none'",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Permissions-Policy": "camera=(), geolocation=(), microphone=()",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
    "Cache-Control": "no-store",
}
"""Headers of every response."""

READING: Final = ("GET", "HEAD")
"""Methods that change nothing."""

WRITABLE: Final = "/api/notes/"
"""Prefix of paths to which a page may write: the notes of a run."""

_LOOPBACK: Final = ("127.0.0.1", "localhost", "[::1]")
_LOCKED: Final = (
    "Open the address that glue-view printed, with its token: it opens this page once for each browser."
)


class Address:
    """Names by which browsers may address the server.

    Args:
        port: at which it listens.
        proxy: the address of a proxy in front of it, such as `https://lab.example/runs`; may be empty.
        open_to_all: whether other machines may connect too, by any of its IP addresses or its own name.
    """

    def __init__(self, port: int, proxy: str = "", open_to_all: bool = False) -> None:
        self.port = port
        self.secure: bool = proxy.startswith("https://")
        self._hosts = {f"{name}:{port}" for name in _LOOPBACK}
        self._any_ip = open_to_all
        if proxy:
            self._hosts.add(urlsplit(proxy).netloc.lower())
        if open_to_all:
            self._hosts |= {f"{name.lower()}:{port}" for name in (socket.gethostname(), socket.getfqdn())}

    def knows_host(self, host: str) -> bool:
        """Return whether a request may have this Host; names that anyone can point here are refused."""
        return host.lower() in self._hosts or (self._any_ip and self._is_ip(host))

    def knows_origin(self, origin: str) -> bool:
        """Return whether a request may come from a page of this Origin."""
        scheme, _, host = origin.partition("://")
        return scheme in ("http", "https") and self.knows_host(host)

    def _is_ip(self, host: str) -> bool:
        name, _, port = host.rpartition(":")
        try:
            ipaddress.ip_address(name.strip("[]"))
        except ValueError:
            return False
        return port == str(self.port)


class Guard:
    """Passes to `app` the requests that `address` and `refusal` allow, and adds `HEADERS` to every response.

    Args:
        app: the guarded application.
        address: names by which it may be addressed.
    """

    def __init__(self, app: ASGIApp, address: Address) -> None:
        self._app = app
        self._address = address

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] == "lifespan":
            await self._app(scope, receive, send)
            return
        if scope["type"] != "http":
            raise RuntimeError(f"the page has no {scope['type']}")

        async def send_guarded(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(raw=message["headers"])
                for name, value in HEADERS.items():
                    headers.setdefault(name, value)
                message["headers"] = headers.raw
            await send(message)

        request = Request(scope)
        refused = self._foreign(request.headers) or self.refusal(request)
        await (refused or self._app)(scope, receive, send_guarded)

    def refusal(self, request: Request) -> Response | None:
        """Return the refusal of a request that is not foreign; None if it may pass."""
        raise NotImplementedError

    def admit(self, request: Request) -> None:
        """Keep the connection of a request from now on: its sender has shown who they are."""
        if admit := request.scope.get("state", {}).get(ADMIT):
            admit()

    def logged_in(self, cookie: str, value: str) -> Response:
        """Return the response to a token, which leaves the address: a cookie, and the page without it."""
        response = RedirectResponse("./", 303)
        response.set_cookie(cookie, value, httponly=True, samesite="strict", secure=self._address.secure)
        return response

    def _foreign(self, headers: Headers) -> Response | None:
        if not all(map(self._address.knows_host, headers.getlist("host") or [""])):
            return PlainTextResponse("This Host is not one by which the page may be called.", 403)
        foreign = (
            headers.get("sec-fetch-site") == "cross-site" and headers.get("sec-fetch-mode") != "navigate"
        )
        if foreign or not all(map(self._address.knows_origin, headers.getlist("origin"))):
            return PlainTextResponse("The page is not open to other sites.", 403)
        return None


class Locked(Guard):
    """Opens everything to anyone who has the token, and nothing to anyone else.

    Args:
        app, address: as for `Guard`.
        token: secret that opens it, as `?token=...` of its first page.
    """

    def __init__(self, app: ASGIApp, address: Address, token: str) -> None:
        super().__init__(app, address)
        self._token = token
        self._cookie = f"glue-view-{address.port}"  # cookies do not distinguish ports
        self._session = secrets.token_urlsafe(32)

    def refusal(self, request: Request) -> Response | None:
        """Return the refusal of a request without the cookie, or that writes more than notes."""
        writes = request.method == "PUT" and request.url.path.startswith(WRITABLE)
        if writes and not request.headers.getlist("origin"):
            return PlainTextResponse("Only the page itself may write.", 403)
        if request.method not in READING and not writes:
            return PlainTextResponse("Only notes can be written.", 405, {"Allow": ", ".join(READING)})
        token = request.query_params.get("token")
        if request.url.path == "/" and token is not None and _equal(token, self._token):
            return self.logged_in(self._cookie, self._session)
        if not _equal(cookie_of(request, self._cookie), self._session):
            return PlainTextResponse(_LOCKED, 403)
        self.admit(request)
        return None


def cookie_of(request: Request, name: str) -> str:
    """Return the value of a cookie; empty if the request has none."""
    try:
        sent = SimpleCookie(request.headers.get("cookie", ""))
    except CookieError:
        return ""
    return sent[name].value if name in sent else ""


def _equal(sent: str, expected: str) -> bool:
    return hmac.compare_digest(sent.encode(errors="replace"), expected.encode())
