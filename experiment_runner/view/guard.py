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

_METHODS: Final = ("GET", "HEAD")
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
    """Passes to `app` the requests that address and token allow, and adds `HEADERS` to every response.

    Args:
        app: the guarded application.
        address: names by which it may be addressed.
        token: secret that opens it, as `?token=...` of its first page.
    """

    def __init__(self, app: ASGIApp, address: Address, token: str) -> None:
        self._app = app
        self._address = address
        self._token = token
        self._cookie = f"glue-view-{address.port}"  # cookies do not distinguish ports
        self._session = secrets.token_urlsafe(32)

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

        refusal = self._refusal(Request(scope))
        if refusal is None and (admit := scope.get("state", {}).get(ADMIT)):
            admit()
        await (refusal or self._app)(scope, receive, send_guarded)

    def _refusal(self, request: Request) -> Response | None:
        """Return the refusal of a request; None if it may pass."""
        headers = request.headers
        if not all(map(self._address.knows_host, headers.getlist("host") or [""])):
            return PlainTextResponse("This Host is not one by which the page may be called.", 403)
        foreign = (
            headers.get("sec-fetch-site") == "cross-site" and headers.get("sec-fetch-mode") != "navigate"
        )
        if foreign or not all(map(self._address.knows_origin, headers.getlist("origin"))):
            return PlainTextResponse("The page is not open to other sites.", 403)
        writes = request.method == "PUT" and request.url.path.startswith(WRITABLE)
        if writes and not headers.getlist("origin"):
            return PlainTextResponse("Only the page itself may write.", 403)
        if request.method not in _METHODS and not writes:
            return PlainTextResponse("Only notes can be written.", 405, {"Allow": ", ".join(_METHODS)})
        token = request.query_params.get("token")
        if request.url.path == "/" and token is not None and _equal(token, self._token):
            response = RedirectResponse("./", 303)
            response.set_cookie(
                self._cookie, self._session, httponly=True, samesite="strict", secure=self._address.secure
            )
            return response
        if not _equal(self._sent_cookie(headers), self._session):
            return PlainTextResponse(_LOCKED, 403)
        return None

    def _sent_cookie(self, headers: Headers) -> str:
        try:
            sent = SimpleCookie(headers.get("cookie", ""))
        except CookieError:
            return ""
        return sent[self._cookie].value if self._cookie in sent else ""


def _equal(sent: str, expected: str) -> bool:
    return hmac.compare_digest(sent.encode(errors="replace"), expected.encode())
