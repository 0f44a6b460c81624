"""The gateway's own errors, its log, and its share of the hub's memory: no other session notices them."""

from __future__ import annotations

import socket
import struct
import threading
from collections.abc import Iterator
from contextlib import closing, suppress

import pytest

from glue.errors import PeerLost
from glue.hub.config import HubConfig, LegacyPort
from glue.hub.io.server import Hub
from glue.legacy.experiment import LegacyExperiment
from glue.legacy.gateway import Gateway
from glue.legacy.peers import LegacyPlayer
from glue.wire.messages import Kind, Message
from tests.system.conformance import FiveStepEnvironment, MirrorAgent
from tests.system.legacy.legacy_client import TIMEOUT, Closed, Connection, Id
from tests.system.legacy.legacy_rig import Rig, gateway

FAULTY = "faulty"


@pytest.fixture
def rig() -> Iterator[Rig]:
    """A hub with a session that plays, and another one without players."""
    with gateway("default", FAULTY, heartbeat=0.05, timeout=0.5, max_body=2**18, max_memory=2**20) as rig:
        rig.agent(MirrorAgent())
        rig.environment(FiveStepEnvironment())
        rig.log.wait_for("joined", times=2)
        yield rig


def raise_fault(*_: object) -> None:
    raise ZeroDivisionError("a fault of the gateway")


def check_ended(connection: Connection) -> None:
    """Check that the program's connection was reset or closed."""
    with closing(connection), pytest.raises((ConnectionResetError, Closed)):
        connection.receive()


def play(rig: Rig) -> None:
    """Play an episode in the session without the fault."""
    experiment = rig.experiment()
    experiment.init()
    assert experiment.episode(0) == 1
    experiment.close()


@pytest.mark.parametrize("role", [Id.AGENT_CONNECTION, Id.EXPERIMENT_CONNECTION])
def test_an_error_in_a_handler_costs_its_connection_and_role_alone(
    rig: Rig, role: Id, monkeypatch: pytest.MonkeyPatch
) -> None:
    connection = rig.connect(session=FAULTY)
    connection.send(role)
    rig.log.wait_for("joined", times=3)
    with monkeypatch.context() as patch:
        patch.setattr(LegacyPlayer if role is Id.AGENT_CONNECTION else LegacyExperiment, "_work", raise_fault)
        connection.send(Id.RL_NUM_STEPS)
        rig.log.wait_for("please report this")
    check_ended(connection)
    rig.log.wait_for("was dropped after an error of the hub", times=2)  # its connection, and its role
    assert "ZeroDivisionError: a fault of the gateway" in str(rig.log)
    play(rig)


def test_an_error_in_a_delivery_costs_the_receiver_and_not_the_sender(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    deliver = LegacyPlayer._take

    def take(player: LegacyPlayer, message: Message) -> bool:
        if message.session == FAULTY and message.kind is Kind.AGENT_MESSAGE:
            raise_fault()
        return deliver(player, message)

    monkeypatch.setattr(LegacyPlayer, "_take", take)
    agent = rig.connect(session=FAULTY)
    agent.send(Id.AGENT_CONNECTION)
    rig.log.wait_for("joined", times=3)
    with rig.native(FAULTY) as experiment:
        with pytest.raises(PeerLost, match="unreachable"):
            experiment.rl_agent_message("hello")
        assert experiment.rl_num_steps() == 0
    check_ended(agent)
    play(rig)


def test_an_error_in_accepting_costs_the_connection_alone(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    with monkeypatch.context() as patch:
        patch.setattr("glue.legacy.gateway._Handshake", raise_fault)
        check_ended(rig.connect(session=FAULTY))
    rig.log.wait_for("please report this")
    play(rig)


def test_bytes_of_original_programs_count_and_the_largest_holder_is_dropped(rig: Rig) -> None:
    announced = 12 + 4 * 500_000
    program = rig.connect(session=FAULTY)
    program.send(Id.EXPERIMENT_CONNECTION)
    with suppress(ConnectionError):  # dropped before all is sent
        program.send_raw(struct.pack(">iI", Id.RL_ENV_STEP, announced) + bytes(announced - 1))
    rig.log.wait_for("was dropped: it used 1 MiB")
    program.reset()
    play(rig)


def test_nothing_waits_for_the_log_of_the_gateway() -> None:
    stuck, go_on = threading.Event(), threading.Event()

    def write(line: str) -> None:
        stuck.set()
        assert go_on.wait(TIMEOUT)

    hub = Hub(HubConfig(bind=("tcp://127.0.0.1:*",)))
    (port,) = Gateway(hub, [LegacyPort(0)], write).ports
    with hub.in_background():
        try:
            for _ in range(3):
                with socket.create_connection(("127.0.0.1", port.port), TIMEOUT) as program:
                    program.sendall(struct.pack(">iI", 99, 0))
                    assert program.recv(1) == b""
            assert stuck.wait(TIMEOUT)
        finally:
            go_on.set()
