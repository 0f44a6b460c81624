"""The hub as a program's part: addresses it can listen on, and how it ends."""

from __future__ import annotations

import socket
from pathlib import Path

import pytest

from glue import client
from glue.config import HubConfig
from glue.errors import ConfigError, GlueError, HubClosed
from glue.hub import Hub


def hub(*urls: str) -> Hub:
    return Hub(HubConfig(bind=urls, heartbeat=0.05))


def close(listening: Hub) -> None:
    with listening.in_background():
        pass


def test_a_free_port_is_named() -> None:
    listening = hub("tcp://127.0.0.1:*", "tcp://[::1]:*")
    for url, host in zip(listening.endpoints, ("127.0.0.1", "[::1]"), strict=True):
        address, _, port = url.rpartition(":")
        assert address == f"tcp://{host}"
        with socket.create_connection((host.strip("[]"), int(port))):
            pass
    close(listening)


def test_an_address_in_use_is_an_error_that_says_what_to_do(tmp_path: Path) -> None:
    first = hub("tcp://127.0.0.1:*", f"ipc://{tmp_path}/hub")
    for url in first.endpoints:
        with pytest.raises(ConfigError, match=f"{url} is in use: is another hub .* running there"):
            hub("tcp://127.0.0.1:*", url)
    close(first)


def test_an_address_of_another_machine_is_an_error() -> None:
    with pytest.raises(ConfigError, match=r"tcp://192\.0\.2\.1:4097 is not an address of this machine"):
        Hub(HubConfig(bind=("tcp://192.0.2.1:4097",), insecure=True))
    with pytest.raises(ConfigError, match=r"tcp://nowhere\.invalid:4097 is not an address of this machine"):
        Hub(HubConfig(bind=("tcp://nowhere.invalid:4097",), insecure=True))


def test_a_socket_that_a_killed_hub_left_is_replaced_and_a_file_is_not(tmp_path: Path) -> None:
    left = tmp_path / "left"
    with socket.socket(socket.AF_UNIX) as killed:
        killed.bind(str(left))
    listening = hub(f"ipc://{left}")
    close(listening)
    assert not left.exists()
    left.write_text("something of mine")
    with pytest.raises(ConfigError, match="in use"):
        hub(f"ipc://{left}")
    assert left.read_text() == "something of mine"


@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
def test_a_hub_that_fails_tells_its_peers_and_whoever_waits_for_it() -> None:
    failing = hub("tcp://127.0.0.1:*")

    def fail(now: float) -> None:
        raise ZeroDivisionError

    with failing.in_background(), client.connect(failing.endpoints[0]) as glue:
        failing.loop.on_tick(fail)
        with pytest.raises(GlueError, match="the hub failed, by a mistake of its own"):
            failing.wait()
        with pytest.raises(HubClosed, match="the hub failed"):
            glue.rl_init()
