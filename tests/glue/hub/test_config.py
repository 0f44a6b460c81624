"""Addresses, sessions and limits: errors name the mistake and a correct form."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from glue.errors import ConfigError
from glue.hub.config import DEFAULT_HUB, Bind, HubConfig, Keys, LegacyPort, Permit, check_session, check_url
from glue.wire.messages import MAX_BODY, MAX_NAME, Role

NO_ADDRESSES = (
    *(
        "4097",
        "localhost:4097",
        "http://localhost:4097",
        "tcp://localhost",
        "tcp://localhost:",
        "tcp://:4097",
    ),
    *("tcp://::1:4097", "tcp://localhost:port", "tcp://localhost:4097/path", "ipc://"),
)


@pytest.mark.parametrize(
    ("url", "complaint"),
    [
        *((url, "write tcp://host:port or ipc://path") for url in ("", *NO_ADDRESSES)),
        ("tcp://localhost:0", "from 1 to 65535"),
        ("tcp://localhost:65536", "from 1 to 65535"),
        ("ipc://" + "x" * 108, "has 108 bytes"),
        ("tcp://local\nhost:4097", "unprintable characters"),
        ("ipc:///tmp/\udcff", "unprintable characters"),
    ],
)
def test_what_is_no_address_of_a_hub_is_refused(url: str, complaint: str) -> None:
    with pytest.raises(ConfigError, match=complaint):
        check_url(url)


@pytest.mark.parametrize("name", ["default", "a b", "é", "x" * MAX_NAME])
def test_a_printable_name_is_a_session(name: str) -> None:
    assert check_session(name) == name


@pytest.mark.parametrize("name", ["", "x" * (MAX_NAME + 1), "a\nb", "\x1b[2J", "\udcff"])
def test_what_cannot_be_printed_is_no_session(name: str) -> None:
    with pytest.raises(ConfigError, match="1 to 255 printable characters"):
        check_session(name)


@pytest.mark.parametrize(
    "url",
    [
        *("tcp://127.0.0.1:*", "tcp://127.3.2.1:9", "tcp://[::1]:9", "tcp://localhost:1", DEFAULT_HUB),
        *("ipc://x", "ipc:///tmp/hub.sock", "ipc://@abstract"),
    ],
)
def test_a_hub_may_listen_where_only_this_machine_reaches(url: str) -> None:
    assert HubConfig(bind=(url,)).bind == (check_url(url),) == (url,)


@pytest.mark.parametrize(
    "url",
    [
        "tcp://*:9",
        "tcp://0.0.0.0:9",
        "tcp://192.168.1.5:9",
        "tcp://[::]:9",
        "tcp://eth0:9",
        "tcp://example.org:65535",
    ],
)
def test_a_hub_open_to_others_must_be_said_to_be_insecure(url: str) -> None:
    with pytest.raises(ConfigError, match="can be reached from other machines") as raised:
        HubConfig(bind=(DEFAULT_HUB, url))
    assert "insecure" in raised.value.settings
    assert HubConfig(bind=(url,), insecure=True).insecure


@pytest.mark.parametrize(
    ("settings", "complaint"),
    [
        ({"heartbeat": 0.0}, "the heartbeat must be positive"),
        ({"heartbeat": -1.0}, "the heartbeat must be positive"),
        ({"heartbeat": 6.0, "timeout": 5.0}, "they are 6 s and 5 s"),
        ({"heartbeat": float("nan")}, "the heartbeat must be positive"),
        ({"timeout": float("inf")}, "a week or less"),
        ({"max_body": 0}, f"from 1 to {MAX_BODY} bytes, not 0"),
        ({"max_body": MAX_BODY + 1}, f"from 1 to {MAX_BODY} bytes"),
        ({"greeting": -1.0}, "greeting must be from 0 to 604800 seconds, not -1.0"),
        ({"farewell": float("nan")}, "farewell must be from 0"),
        ({"max_sessions": 0}, "max_sessions must be at least 1, not 0"),
        ({"bind": ("tcp://nowhere",)}, "is not the address of a hub"),
    ],
)
def test_times_and_limits_out_of_range_are_refused(settings: dict[str, Any], complaint: str) -> None:
    with pytest.raises(ConfigError, match=complaint):
        HubConfig(**settings)


@pytest.mark.parametrize("parse", [check_url, LegacyPort.parse])
@pytest.mark.parametrize("start", ["tcp://127.0.0.1:", "ipc://", ""])
def test_a_long_address_is_not_repeated_in_full(parse: Callable[[str], object], start: str) -> None:
    with pytest.raises(ConfigError) as caught:
        parse(start + "9" * 5000)
    assert len(str(caught.value)) < 250


def test_an_address_admits_the_roles_and_sessions_that_it_names() -> None:
    one = Bind("ipc:///tmp/hub", frozenset({Role.AGENT}), frozenset({"a"}))
    assert one.admits(Role.AGENT, "a")
    assert not one.admits(Role.AGENT, "b")
    assert not one.admits(Role.EXPERIMENT, "a")
    (everything,) = HubConfig(bind=("tcp://127.0.0.1:*",)).binds
    assert all(everything.admits(role, "any") for role in Role)


@pytest.mark.parametrize("closed", [{"roles": frozenset()}, {"sessions": frozenset()}])
def test_an_address_at_which_no_peer_could_join_is_an_error(closed: dict[str, Any]) -> None:
    with pytest.raises(ConfigError, match="no peer could join at ipc:///tmp/hub"):
        Bind("ipc:///tmp/hub", **closed)


def test_an_address_with_roles_is_checked_as_any_other() -> None:
    with pytest.raises(ConfigError, match="can be reached from other machines"):
        HubConfig(bind=(Bind("tcp://*:4097", frozenset({Role.AGENT})),))


def test_a_key_has_32_bytes() -> None:
    permit = Permit("carol", frozenset(Role), None)
    for secret, client in ((bytes(31), bytes(32)), (bytes(32), bytes(33))):
        with pytest.raises(ConfigError, match="a key has 32 bytes"):
            Keys(secret, {client: permit})


# Ports for original programs


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


NO_PORTS = ("", "x", "=a", ":4096", "4096:", "-1", "4 096", "::1:4096", "a=b:4096", "4096 ")


@pytest.mark.parametrize(
    ("text", "why"),
    [
        *((text, r"write \[HOST:\]PORT\[=SESSION\]") for text in NO_PORTS),
        *((text, "from 1 to 65535") for text in ("0", "65536", "99999=b")),
        *((f"4096={name}", "the name of a session") for name in ("", "a\tb", "x" * 256)),
    ],
)
def test_what_is_no_port_is_refused(text: str, why: str) -> None:
    with pytest.raises(ConfigError, match=why):
        LegacyPort.parse(text)


@pytest.mark.parametrize("text", ["0.0.0.0:4096", "192.0.2.1:4096=b", "[::]:4096", "glue.example:4096"])
def test_a_port_open_to_other_machines_must_be_said_to_be_insecure(text: str) -> None:
    with pytest.raises(ConfigError) as raised:
        LegacyPort.parse(text)
    assert "insecure" in raised.value.settings
    assert LegacyPort.parse(text, insecure=True).port == 4096


def test_a_port_is_shown_as_an_address_and_its_session() -> None:
    assert str(LegacyPort(4096)) == "127.0.0.1:4096, session 'default'"
    assert str(LegacyPort(4096, "b", "::1")) == "[::1]:4096, session 'b'"
