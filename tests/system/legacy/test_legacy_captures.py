"""Recordings of original runs, played to our server: it must send the bytes of the original server."""

from __future__ import annotations

import json
import socket
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from tests.scripted.peer import ScriptedPeer
from tests.system.legacy.legacy_rig import Rig

CAPTURES = sorted((Path(__file__).parents[2] / "golden" / "captures").glob("*.json"))


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


def test_all_sides_of_one_recording_after_the_other_get_the_bytes_of_the_original_server(rig: Rig) -> None:
    for capture in CAPTURES * 2:
        events = json.loads(capture.read_text())["frames"]
        assert len(events) > 6
        with ExitStack() as stack:
            clients: dict[str, ScriptedPeer] = {}
            for event in events:
                if event.get("event") == "connect":
                    client = ScriptedPeer(f"tcp://127.0.0.1:{rig.port()}").connect()
                    clients[event["role"]] = stack.enter_context(client)
                else:
                    play(clients[event["role"]], event)
