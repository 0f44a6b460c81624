"""The hub as part of a program: the addresses that it can listen on, its end, and what it forgets."""

from __future__ import annotations

import gc
import socket
import threading
from pathlib import Path

import pytest

from glue.client.experiment import connect
from glue.errors import ConfigError, GlueError, HubClosed
from glue.hub.channel import Channel
from glue.hub.config import HubConfig, LegacyPort
from glue.hub.io.listener import open_address
from glue.hub.io.server import Hub
from glue.hub.sessions import Sessions
from glue.legacy.gateway import Gateway
from glue.system import network
from glue.types import Action, Observation
from glue.wire import zmtp
from glue.wire.messages import Kind, Message
from glue.wire.steps import StepFormat
from tests.scripted.peer import TIMEOUT, ScriptedPeer, framed


def hub(*urls: str) -> Hub:
    return Hub(HubConfig(bind=urls, heartbeat=0.05, greeting=TIMEOUT))


def port_of(listening: Hub) -> int:
    return int(listening.endpoints[0].rpartition(":")[2])


def test_a_free_port_is_named() -> None:
    with hub("tcp://127.0.0.1:*", "tcp://[::1]:*") as listening:
        for url, host in zip(listening.endpoints, ("127.0.0.1", "[::1]"), strict=True):
            address, _, port = url.rpartition(":")
            assert address == f"tcp://{host}"
            socket.create_connection((host.strip("[]"), int(port))).close()


def test_an_address_in_use_is_an_error_that_says_what_to_do(tmp_path: Path) -> None:
    first = hub("tcp://127.0.0.1:*", f"ipc://{tmp_path}/hub")
    for url in first.endpoints:
        with pytest.raises(ConfigError, match=f"{url} is in use") as caught:
            hub("tcp://127.0.0.1:*", url)
        assert caught.value.settings == ("bind",)
    first.close()


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
    listening.close()
    assert not left.exists()
    left.write_text("something of mine")
    with pytest.raises(ConfigError, match="in use"):
        hub(f"ipc://{left}")
    assert left.read_text() == "something of mine"


def test_a_path_that_another_hub_has_taken_is_left_to_it(tmp_path: Path) -> None:
    path = tmp_path / "hub"
    first = hub(f"ipc://{path}")
    path.unlink()
    second = hub(f"ipc://{path}")
    first.close()
    assert path.exists()
    second.close()
    assert not path.exists()


def test_a_hub_that_never_ran_closes_with_its_context(tmp_path: Path) -> None:
    taken = f"ipc://{tmp_path}/hub"
    for _ in range(2):
        with hub("tcp://127.0.0.1:*", taken) as listening, pytest.raises(ConfigError, match="in use"):
            hub(taken)
        with pytest.raises(ConnectionRefusedError):
            socket.create_connection(("127.0.0.1", port_of(listening)))


def test_a_hub_whose_gateway_cannot_start_listens_no_longer() -> None:
    with (
        socket.create_server(("127.0.0.1", 0)) as other,
        pytest.raises(ConfigError, match="is in use") as raised,
        hub("tcp://127.0.0.1:*") as listening,
    ):
        Gateway(listening, [LegacyPort(0), LegacyPort(other.getsockname()[1])])
    assert raised.value.settings == ("legacy_port",)
    with pytest.raises(ConnectionRefusedError):
        socket.create_connection(("127.0.0.1", port_of(listening)))


def test_an_address_opened_once_serves_one_hub_after_another_and_refuses_no_connection_between() -> None:
    with open_address("tcp://127.0.0.1:*") as address:
        config = HubConfig(bind=(address.url,), heartbeat=0.05, greeting=TIMEOUT, farewell=0.1)
        for _ in range(2):
            with (
                socket.create_connection(("127.0.0.1", address.port), TIMEOUT) as early,
                Hub(config, opened={address.url: address}).in_background() as listening,
            ):
                assert listening.endpoints == [address.endpoint]
                assert early.recv(64) == zmtp.GREETING
        port = address.port
    with pytest.raises(ConnectionRefusedError):
        socket.create_connection(("127.0.0.1", port))


def test_a_name_stands_for_its_ipv4_address(monkeypatch: pytest.MonkeyPatch) -> None:
    resolve = socket.getaddrinfo

    def prefer_ipv6(host: str, port: int, family: int = 0, *how: int, **more: int) -> object:
        return resolve("::1" if family == socket.AF_UNSPEC else host, port, family, *how, **more)

    monkeypatch.setattr(network, "getaddrinfo", prefer_ipv6)
    listening = hub("tcp://localhost:*")
    assert listening.endpoints[0].startswith("tcp://127.0.0.1:")
    listening.close()


def test_the_longest_heartbeat_lets_peers_in() -> None:
    listening = Hub(HubConfig(bind=("tcp://127.0.0.1:*",), heartbeat=7 * 86400, timeout=7 * 86400))
    port = port_of(listening)
    with listening.in_background(), socket.create_connection(("127.0.0.1", port)) as peer:
        assert peer.recv(64) == zmtp.GREETING


@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
def test_a_hub_that_fails_notifies_its_peers_and_raises_in_wait() -> None:
    failing = hub("tcp://127.0.0.1:*")

    def fail(now: float) -> None:
        raise ZeroDivisionError

    with failing.in_background(), connect(failing.endpoints[0]) as glue:
        failing.loop.on_tick(fail)
        with pytest.raises(GlueError, match="internal error in the hub"):
            failing.wait()
        with pytest.raises(HubClosed, match="the hub failed"):
            glue.rl_init()


def test_an_error_of_the_hub_costs_one_connection_and_is_reported() -> None:
    class Faulty(Sessions):
        def receive(self, channel: Channel, message: Message, now: float) -> bool:
            if message.kind is Kind.RL_RETURN:
                raise ZeroDivisionError("a fault of the hub")
            return super().receive(channel, message, now)

    lines: list[str] = []
    config = HubConfig(bind=("tcp://127.0.0.1:*",), heartbeat=0.05, greeting=TIMEOUT)
    listening = Hub(config, lines.append)
    listening.sessions.__class__ = Faulty
    with listening.in_background(), connect(listening.endpoints[0], "other") as other:
        with connect(listening.endpoints[0], "one") as one:
            assert one.rl_num_steps() == 0
            with pytest.raises(HubClosed, match="knows nothing of this experiment"):
                one.rl_return()
        with (
            connect(listening.endpoints[0], "first request") as first,
            pytest.raises(HubClosed, match="in succession after RL_RETURN was sent"),
        ):
            first.rl_return()
        assert other.rl_num_episodes() == 0
    report, *more = [line for line in lines if "please report" in line]
    assert 1 < len(more) < 10, "the first request is sent again, and not forever"
    assert "ZeroDivisionError: a fault of the hub" in report
    assert "Traceback" in report
    assert any("'one': experiment" in line and "after an error of the hub" in line for line in lines)


def test_everything_sent_before_a_reset_is_received() -> None:
    joined, left = threading.Semaphore(0), threading.Semaphore(0)

    def log(line: str) -> None:
        for event, semaphore in (("joined", joined), ("left: the end", left)):
            if event in line:
                semaphore.release()

    listening = Hub(
        HubConfig(bind=("tcp://127.0.0.1:*",), heartbeat=0.05, timeout=TIMEOUT, greeting=TIMEOUT), log
    )
    sessions = [f"{number}" for number in range(listening.config.max_joined)]

    with listening.in_background():
        with ScriptedPeer(listening.endpoints[0]).greet() as peer:
            for session in sessions:
                peer.hello("agent", session=session)
            assert all(joined.acquire(timeout=TIMEOUT) for _ in sessions)
            goodbyes = [peer.frames_of(Kind.GOODBYE, 0, "the end", session=name) for name in sessions]
            peer.send_bytes(b"".join(framed(*goodbye) for goodbye in goodbyes))
            # The peer has not read its welcomes, so its close is a reset.
        assert all(left.acquire(timeout=TIMEOUT) for _ in sessions)


def formats(session: str) -> int:
    return sum(type(each) is StepFormat and each.session == session for each in gc.get_objects())


def test_formats_of_steps_end_with_the_session_and_not_with_the_connection() -> None:
    config = HubConfig(bind=("tcp://127.0.0.1:*",), heartbeat=60.0, timeout=60.0)
    with (
        Hub(config).in_background() as hub,
        ScriptedPeer(hub.endpoints[0], session="forgotten").greet() as environment,
        ScriptedPeer(hub.endpoints[0], session="forgotten").greet() as experiment,
    ):
        environment.join("environment", session="kept")
        environment.join("environment")
        experiment.join("experiment")
        experiment.say(Kind.RL_ENV_STEP, 1, body=Action([1]).body)
        while (call := environment.receive()).kind is not Kind.ENV_STEP:
            environment.say(call.kind, call.seq)
        environment.say(Kind.ENV_STEP, call.seq, 1.0, False, body=Observation([2]).body)
        while experiment.receive().kind is not Kind.RL_ENV_STEP:
            pass
        assert formats("forgotten") > 0
        environment.say(Kind.GOODBYE, 0, "enough")
        environment.say(Kind.HEARTBEAT, 7, session="kept")
        environment.receive_frames()  # the hub has read the GOODBYE
        assert formats("forgotten") == 0
