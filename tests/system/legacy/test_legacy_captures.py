"""Recordings of original runs, played to our server: it must send the bytes of the original server."""

from __future__ import annotations

import json
import socket
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest

from tests.scripted.peer import ScriptedPeer
from tests.system.conformance import FiveStepEnvironment, MirrorAgent
from tests.system.legacy.legacy_rig import Rig, gateway

CAPTURES = sorted((Path(__file__).parents[2] / "golden" / "captures").glob("*.json"))
ROLES = ("agent", "environment", "experiment")


def play(client: ScriptedPeer, event: dict[str, Any]) -> None:
    """Send the recorded bytes of a client, or check those of the server."""
    where = f"{event['role']}, number {event['seq']}"
    recorded = bytes.fromhex(event.get("hex", ""))
    if event["from"] == "client":
        client.send_bytes(recorded)
        if event.get("event") == "eof":
            client.socket.shutdown(socket.SHUT_WR)
    elif event.get("event") == "eof":
        assert client.read_to_end() == b"", where
    else:
        assert client.read(len(recorded)) == recorded, where


def replay(capture: Path, rig: Rig, roles: tuple[str, ...] = ROLES) -> int:
    """Play the connections of `roles` in the order of the recording; return the number of events."""
    events = [event for event in json.loads(capture.read_text())["frames"] if event["role"] in roles]
    with ExitStack() as stack:
        clients: dict[str, ScriptedPeer] = {}
        for event in events:
            if event.get("event") == "connect":
                client = ScriptedPeer(f"tcp://127.0.0.1:{rig.port()}").connect()
                clients[event["role"]] = stack.enter_context(client)
            else:
                play(clients[event["role"]], event)
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
