"""Recordings of original runs, played to our server: it must send the bytes of the original server."""

from __future__ import annotations

import json
import socket
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest

from glue.roles import Agent, Environment
from tests.scripted.peer import ScriptedPeer
from tests.system.conformance import FiveStepEnvironment, MirrorAgent
from tests.system.legacy.legacy_rig import Rig

CAPTURES = sorted((Path(__file__).parents[2] / "golden" / "captures").glob("*.json"))
OF_A1_AND_E1 = [path for path in CAPTURES if path.stem in ("c_test_sanity", "c_test_1", "c_test_rl_episode")]
PLAYERS: dict[str, Agent | Environment] = {"agent": MirrorAgent(), "environment": FiveStepEnvironment()}
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


def replay(capture: Path, rig: Rig, *roles: str) -> None:
    """Play the connections of `roles` in the order of the recording."""
    events = [event for event in json.loads(capture.read_text())["frames"] if event["role"] in roles]
    assert len(events) > 6
    with ExitStack() as stack:
        clients: dict[str, ScriptedPeer] = {}
        for event in events:
            if event.get("event") == "connect":
                client = ScriptedPeer(f"tcp://127.0.0.1:{rig.port()}").connect()
                clients[event["role"]] = stack.enter_context(client)
            else:
                play(clients[event["role"]], event)


def test_all_sides_of_one_recording_after_the_other_get_the_bytes_of_the_original_server(rig: Rig) -> None:
    for capture in CAPTURES * 2:
        replay(capture, rig, *ROLES)


@pytest.mark.parametrize("ours", [("agent", "environment"), ("agent",), ("environment",)], ids="+".join)
def test_recorded_programs_get_the_same_beside_ours(rig: Rig, ours: tuple[str, ...]) -> None:
    rig.ours(*(player for role, player in PLAYERS.items() if role in ours))
    for capture in OF_A1_AND_E1:
        replay(capture, rig, *(role for role in ROLES if role not in ours))
