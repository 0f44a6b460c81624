"""Requests over HTTP that are signed with the key of their sender.

Five headers sign a request: who sends it, when, to which start of its receiver, the SHA-256 of its body, and
the XEd25519 signature of all four with its method and path. So a request is checked before its body is read,
and the body while it is. A receiver remembers the requests that it has had; what one that has been started
again no longer remembers was signed for another start.
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import islice
from typing import Final

from glue.errors import GlueError
from glue.keys.certificates import KeyPair
from glue.keys.signing import is_signed, sign

ENTRANT: Final = "Glue-Entrant"
TIME: Final = "Glue-Time"
START: Final = "Glue-Start"
DIGEST: Final = "Glue-Digest"
SIGNATURE: Final = "Glue-Signature"

SECONDS: Final = 300
"""How far the clocks of sender and receiver may be apart."""

_MOST_REMEMBERED: Final = 200_000

_HEX: Final = frozenset("0123456789abcdef")
_DIGEST_LETTERS: Final = 64
_MOST_DIGITS: Final = 12


class Unsigned(GlueError):
    """A request is not signed by its sender, or not now; the message completes "the request"."""


def signed(
    pair: KeyPair, entrant: str, method: str, path: str, digest: str, start: str, now: float
) -> dict[str, str]:
    """Return the headers that sign a request.

    Args:
        pair: keys of the sender.
        entrant: name of the sender.
        method: such as `POST`.
        path: of the address, from its first slash.
        digest: SHA-256 of the body, in hexadecimal.
        start: what the receiver calls its start.
        now: seconds since 1970.
    """
    headers = {ENTRANT: entrant, TIME: str(int(now)), START: start, DIGEST: digest}
    return {**headers, SIGNATURE: sign(pair.secret, _message(method, path, headers)).hex()}


def check(public: bytes, method: str, path: str, headers: Mapping[str, str], now: float) -> None:
    """Check the signature of a request.

    Args:
        public: the sender's public key, 32 bytes.
        method, path: of the request.
        headers: of the request, from an untrusted source.
        now: seconds since 1970.

    Raises:
        Unsigned: it is missing or wrong, or too old.
    """
    digest, signature = headers.get(DIGEST, ""), headers.get(SIGNATURE, "")
    text = headers.get(TIME, "")
    if len(digest) != _DIGEST_LETTERS or not _HEX.issuperset(digest + signature) or len(signature) % 2:
        raise Unsigned(f"needs the headers {DIGEST} and {SIGNATURE}, in small hexadecimal letters")
    when = int(text) if text.isascii() and text.isdigit() and len(text) <= _MOST_DIGITS else 0
    if abs(now - when) > SECONDS:
        raise Unsigned(
            f"was signed {abs(now - when):.0f} s {'before' if when < now else 'after'} the time here, and "
            f"{SECONDS} s are allowed: set your clock"
        )
    if not is_signed(public, _message(method, path, headers), bytes.fromhex(signature)):
        raise Unsigned("is not signed with the key of an entrant that takes part: see glue-compete join")


class Once:
    """Remembers the signatures of requests, none of which may come twice."""

    def __init__(self) -> None:
        self._until: dict[str, float] = {}  # when each is too old anyway; the oldest first

    def remember(self, headers: Mapping[str, str], now: float) -> None:
        """Remember a request that has passed `check` at `now`.

        Raises:
            Unsigned: it is known, or there were too many to remember.
        """
        for old in list(islice(self._until, 2)):
            if self._until[old] < now:
                del self._until[old]
        if headers[SIGNATURE] in self._until:
            raise Unsigned("has come before: sign each request anew")
        if len(self._until) >= _MOST_REMEMBERED:
            raise Unsigned("comes with too many others: try again in some minutes")
        self._until[headers[SIGNATURE]] = now + 2 * SECONDS


def _message(method: str, path: str, headers: Mapping[str, str]) -> bytes:
    parts = ("glue-season", method, path, *(headers.get(name, "") for name in (ENTRANT, TIME, START, DIGEST)))
    return "\n".join(parts).encode()
