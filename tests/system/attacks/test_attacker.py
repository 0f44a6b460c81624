"""Hostile peers: the hub's memory is bounded, and honest sessions are undisturbed."""

from __future__ import annotations

import socket
import struct
import threading
from contextlib import ExitStack, suppress
from pathlib import Path

import pytest

from glue.types import Observation
from glue.wire.limits import MAX_BODY
from glue.wire.messages import Kind
from tests.proof import size
from tests.scripted.curve import CurveClient, Pair
from tests.scripted.peer import TIMEOUT, ScriptedPeer
from tests.system.attacks.siege import MOST, besiege, hub, make_keys, peak


@pytest.mark.parametrize("stay", [False, True], ids=["and leave", "and stay"])
def test_peers_that_stop_in_the_middle_of_large_frames_fill_no_memory(stay: bool) -> None:
    with hub() as (url, process), ExitStack() as staying:
        for number in range(40):
            with ExitStack() as leaving:
                stack = staying if stay else leaving
                peer = stack.enter_context(ScriptedPeer(url).greet())
                peer.join("agent", session=f"session {number}")
                with suppress(OSError):  # the hub may drop the peer
                    peer.send_bytes(b"\x02" + struct.pack(">Q", MAX_BODY))
                    for _ in range(15):
                        peer.send_bytes(bytes(2**20))
        assert peak(process) <= MOST


@pytest.mark.parametrize("keyed", [False, True], ids=["without keys", "with keys"])
def test_calls_of_the_largest_size_that_are_not_read_have_a_bound_in_all(keyed: bool, tmp_path: Path) -> None:
    options, _, hexadecimal = make_keys(tmp_path) if keyed else ((), {}, ())
    public, secret, server = map(bytes.fromhex, hexadecimal or ("", "", ""))

    def join(role: str, session: str, receive_buffer: int = 0) -> ScriptedPeer:
        while True:
            keys = CurveClient(Pair(public, secret), server) if keyed else None
            peer = ScriptedPeer(url, keys, session=session, receive_buffer=receive_buffer)
            stack.enter_context(peer)
            with suppress(ConnectionError):  # on a busy machine, joining took too long
                peer.greet().join(role)
                return peer

    huge = Observation(chars=bytes(MAX_BODY - 16)).body
    with hub(*options) as (url, process), ExitStack() as stack:
        for number in range(8):
            session = f"m{number}"
            join("agent", session, receive_buffer=4096)
            experiment = join("experiment", session)
            with suppress(OSError):  # the hub may drop the peer
                experiment.say(Kind.RL_AGENT_START, 1, body=huge, session=session)
        assert peak(process) <= MOST


def test_whoever_makes_the_hub_reach_its_limit_is_told() -> None:
    huge = Observation(chars=bytes(MAX_BODY - 16)).body
    with hub() as (url, process), ScriptedPeer(url).greet() as agent, ScriptedPeer(url).greet() as experiment:
        reading = threading.Thread(target=agent.read_to_end)
        reading.start()
        for number in range(12):
            session = f"huge {number}"
            agent.hello("agent", session=session)
            experiment.hello("experiment", session=session)
            experiment.say(Kind.RL_AGENT_START, 1, body=huge, session=session)
        while (message := experiment.receive()).kind is not Kind.GOODBYE:
            pass
        assert "max_memory" in str(message.scalars[0])
        agent.socket.shutdown(socket.SHUT_RDWR)
        reading.join(TIMEOUT)
        assert peak(process) <= MOST


@pytest.mark.proof
@pytest.mark.timeout(900)
@pytest.mark.parametrize("keyed", [False, True], ids=["without keys", "with keys"])
def test_honest_sessions_play_beside_an_attacker_as_if_alone(keyed: bool, tmp_path: Path) -> None:
    besiege(size(2.5, 300.0), keyed, tmp_path)
