"""What a peer of any role sends in one piece behind messages of unknown kinds is read, plain and keyed."""

from __future__ import annotations

import pytest

pytest.importorskip("nacl", reason="needs PyNaCl: pip install 'glue-rl[keys]'")

from glue.hub.config import Bind, HubConfig
from glue.hub.io.server import Hub
from glue.hub.keys import Keys, Permit
from glue.wire.codec import FROM_HUB, decode
from glue.wire.messages import ErrorCode, Kind, Message, Role
from tests.scripted.curve import CurveClient, Pair
from tests.scripted.peer import ScriptedPeer

UNKNOWN = ((bytes((0x93, 99, 0xA1, 0x73, 5)),), (bytes((0x94, 72, 0xA1, 0x73, 6, 1)), b"a body"))
"""The frames of messages in session s: of a kind that nobody knows, and of one that only hubs send."""


@pytest.mark.parametrize("keyed", [False, True], ids=["plain", "keyed"])
@pytest.mark.parametrize("role", Role)
def test_a_hub_reads_what_lies_behind_unknown_kinds(role: Role, keyed: bool) -> None:
    hub_keys, own = Pair.new(), Pair.new()
    permits = {own.public: Permit("somebody", frozenset(Role))}
    bind = Bind("tcp://127.0.0.1:*", keys=Keys(hub_keys.secret, permits) if keyed else None)
    with (
        Hub(HubConfig(bind=(bind,), heartbeat=60.0, timeout=60.0)).in_background() as hub,
        ScriptedPeer(hub.endpoints[0], session="s") as founder,
        ScriptedPeer(hub.endpoints[0], session="s") as peer,
    ):
        if keyed:
            founder.keys, peer.keys = (CurveClient(own, hub_keys.public) for _ in range(2))
        founder.greet().join("agent" if role is not Role.AGENT else "environment")
        peer.greet().join(role)
        beat = peer.frames_of(Kind.HEARTBEAT, 7)
        peer.send_bytes(b"".join(peer.encoded(*frames) for frames in (*UNKNOWN * 2, beat)))
        heard: list[Message] = []
        while not heard or heard[-1].kind is not Kind.HEARTBEAT:
            heard.append(decode(peer.receive_frames(), FROM_HUB))
    errors = [(message.seq, message.scalars[0]) for message in heard if message.kind is Kind.ERROR]
    assert errors == [(5, ErrorCode.UNKNOWN_KIND), (6, ErrorCode.UNKNOWN_KIND)] * 2
    assert heard[-1].seq == 7
