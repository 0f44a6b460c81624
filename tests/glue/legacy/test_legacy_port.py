"""Ports for original programs, as named on the command line."""

from __future__ import annotations

import pytest

from glue.errors import ConfigError
from glue.hub.config import LegacyPort


@pytest.mark.parametrize(
    ("text", "port"),
    [
        ("4096", LegacyPort(4096)),
        ("*", LegacyPort(0)),
        ("5096=b", LegacyPort(5096, "b")),
        ("5096=a=b", LegacyPort(5096, "a=b")),
        ("*=class of 2009", LegacyPort(0, "class of 2009")),
        ("localhost:4096", LegacyPort(4096, host="localhost")),
        ("127.0.0.2:4096=b", LegacyPort(4096, "b", "127.0.0.2")),
        ("[::1]:4096=b", LegacyPort(4096, "b", "::1")),
    ],
)
def test_a_port_has_a_session_and_a_host_if_they_are_said(text: str, port: LegacyPort) -> None:
    assert LegacyPort.parse(text) == port


def test_a_port_that_names_no_session_is_of_the_one_at_hand() -> None:
    assert LegacyPort.parse("4096", "mine") == LegacyPort(4096, "mine")
    assert LegacyPort.parse("4096=yours", "mine") == LegacyPort(4096, "yours")


@pytest.mark.parametrize(
    "text", ["", "x", "=a", ":4096", "4096:", "-1", "4 096", "::1:4096", "a=b:4096", "4096 "]
)
def test_what_is_no_port_is_refused(text: str) -> None:
    with pytest.raises(ConfigError, match=r"write \[HOST:\]PORT\[=SESSION\]"):
        LegacyPort.parse(text)


@pytest.mark.parametrize("text", ["0", "65536", "99999=b"])
def test_a_port_is_from_1_to_65535(text: str) -> None:
    with pytest.raises(ConfigError, match="from 1 to 65535"):
        LegacyPort.parse(text)


@pytest.mark.parametrize("session", ["", "a\tb", "x" * 256])
def test_a_session_has_a_name(session: str) -> None:
    with pytest.raises(ConfigError, match="the name of a session"):
        LegacyPort.parse(f"4096={session}")


@pytest.mark.parametrize("text", ["0.0.0.0:4096", "192.0.2.1:4096=b", "[::]:4096", "glue.example:4096"])
def test_a_port_open_to_other_machines_must_be_said_to_be_insecure(text: str) -> None:
    with pytest.raises(ConfigError) as raised:
        LegacyPort.parse(text)
    assert "insecure" in raised.value.settings
    assert LegacyPort.parse(text, insecure=True).port == 4096


def test_a_port_is_shown_as_an_address_and_its_session() -> None:
    assert str(LegacyPort(4096)) == "127.0.0.1:4096, session 'default'"
    assert str(LegacyPort(4096, "b", "::1")) == "[::1]:4096, session 'b'"
