"""Recordings of original runs, played to our server: it must send what the original server sent."""

from __future__ import annotations

import json
import socket
from pathlib import Path
from typing import Any

import pytest

from tests.system.conformance import FiveStepEnvironment, MirrorAgent
from tests.system.legacy.legacy_client import TIMEOUT
from tests.system.legacy.legacy_rig import Rig, gateway

CAPTURES = sorted((Path(__file__).parents[2] / "golden" / "captures").glob("*.json"))
ROLES = ("agent", "environment", "experiment")


class Player:
    """One recorded connection, played by its client's side."""

    def __init__(self, port: int, role: str) -> None:
        self._role = role
        self._socket = socket.create_connection(("127.0.0.1", port), TIMEOUT)
        self._served = False
        self._left = False

    def play(self, event: dict[str, Any]) -> None:
        """Send what the client sent; receive what the server sent.

        Raises:
            AssertionError: the server sends anything else.
        """
        where = f"{self._role}, number {event['seq']}"
        recorded = bytes.fromhex(event.get("hex", ""))
        if event["from"] == "client":
            self._socket.sendall(recorded)
            if event.get("event") == "eof":
                self._socket.shutdown(socket.SHUT_WR)
        elif event.get("event") == "eof":
            assert self._socket.recv(1) == b"", where
        else:
            assert self._receive(len(recorded)) == recorded, where

    def _receive(self, size: int) -> bytes:
        data = b""
        while len(data) < size and (chunk := self._socket.recv(size - len(data))):
            data += chunk
        return data

    def close(self) -> None:
        self._socket.close()


def replay(capture: Path, rig: Rig, roles: tuple[str, ...] = ROLES) -> int:
    """Play the connections of `roles` in the order of the recording; return the number of events."""
    events = [event for event in json.loads(capture.read_text())["frames"] if event["role"] in roles]
    players: dict[str, Player] = {}
    try:
        for event in events:
            if event.get("event") == "connect":
                players[event["role"]] = Player(rig.port(), event["role"])
            else:
                players[event["role"]].play(event)
    finally:
        for player in players.values():
            player.close()
    return len(events)


@pytest.mark.parametrize("capture", CAPTURES, ids=lambda path: path.stem)
def test_all_three_sides_of_a_recording_get_the_very_bytes_of_the_original(capture: Path) -> None:
    with gateway() as rig:
        assert replay(capture, rig) > 20


def test_the_port_stays_open_for_one_recording_after_the_other() -> None:
    with gateway() as rig:
        for capture in CAPTURES * 2:
            replay(capture, rig)


OF_A1_AND_E1 = [path for path in CAPTURES if path.stem in ("c_test_sanity", "c_test_1", "c_test_rl_episode")]


@pytest.mark.parametrize("capture", [*OF_A1_AND_E1, CAPTURES[-1]], ids=lambda path: path.stem)
def test_a_recorded_experiment_gets_from_our_players_what_it_got_from_the_originals(capture: Path) -> None:
    with gateway() as rig:
        rig.native_agent(MirrorAgent())
        rig.native_environment(FiveStepEnvironment())
        replay(capture, rig, ("experiment",))


@pytest.mark.parametrize("capture", OF_A1_AND_E1, ids=lambda path: path.stem)
@pytest.mark.parametrize("other", ["agent", "environment"])
def test_recorded_players_get_the_same_beside_one_of_ours(capture: Path, other: str) -> None:
    with gateway() as rig:
        if other == "agent":
            rig.native_agent(MirrorAgent())
        else:
            rig.native_environment(FiveStepEnvironment())
        replay(capture, rig, tuple(role for role in ROLES if role != other))
