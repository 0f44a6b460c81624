"""Requests that are signed, those that are not, and those that come twice."""

from __future__ import annotations

import hashlib

import pytest

from glue.client.libzmq import new_pair
from glue.keys.requests import DIGEST, ENTRANT, SECONDS, SIGNATURE, START, TIME, Once, Unsigned, check, signed

PAIR = new_pair()
DIGEST_OF_BODY = hashlib.sha256(b"body").hexdigest()
NOW = 1_800_000_000.5


def request() -> dict[str, str]:
    return signed(PAIR, "alice", "POST", "/season/api/attempt", DIGEST_OF_BODY, "first", NOW)


@pytest.mark.parametrize("now", [NOW, NOW - SECONDS + 1, NOW + SECONDS - 1])
def test_a_request_is_valid_for_some_minutes(now: float) -> None:
    check(PAIR.public, "POST", "/season/api/attempt", request(), now)


UNSIGNED, MALFORMED = "not signed with the key", "Glue-Digest and Glue-Signature"


@pytest.mark.parametrize(
    ("header", "text", "why"),
    [
        (ENTRANT, "bob", UNSIGNED),
        (TIME, str(int(NOW) + 1), UNSIGNED),
        (START, "second", UNSIGNED),
        *((TIME, text, "set your clock") for text in ("x", "9" * 5000, "²", "-5")),
        (DIGEST, hashlib.sha256(b"other").hexdigest(), UNSIGNED),
        *((DIGEST, text, MALFORMED) for text in ("0", "é" * 64)),
        *((SIGNATURE, text, UNSIGNED) for text in ("00" * 64, "")),
        *((SIGNATURE, text, MALFORMED) for text in ("abc", "GG")),
    ],
)
def test_nothing_of_it_can_be_changed(header: str, text: str, why: str) -> None:
    with pytest.raises(Unsigned, match=why):
        check(PAIR.public, "POST", "/season/api/attempt", request() | {header: text}, NOW)


@pytest.mark.parametrize(
    ("method", "path"), [("PUT", "/season/api/attempt"), ("POST", "/season/api/withdraw")]
)
def test_it_is_for_one_purpose(method: str, path: str) -> None:
    with pytest.raises(Unsigned):
        check(PAIR.public, method, path, request(), NOW)


def test_the_key_of_another_does_not_sign() -> None:
    with pytest.raises(Unsigned):
        check(new_pair().public, "POST", "/season/api/attempt", request(), NOW)


def test_a_request_comes_once() -> None:
    once, first = Once(), request()
    once.remember(first, NOW)
    once.remember(request(), NOW)
    with pytest.raises(Unsigned, match="has come before"):
        once.remember(first, NOW + 1)


def test_old_requests_are_forgotten_when_they_could_not_come_again() -> None:
    once = Once()
    for i in range(100):
        once.remember({SIGNATURE: str(i)}, NOW)
    for i in range(60):
        once.remember({SIGNATURE: f"later {i}"}, NOW + 2 * SECONDS + 1)
    assert len(once._until) == 60
