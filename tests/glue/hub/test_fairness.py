"""A session gets its turn regardless of what other connections send: counted in turns of the hub's loop."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack

import pytest

from glue.hub.channel import Channel, Memory
from glue.hub.config import HubConfig
from glue.hub.io.connection import Connection
from glue.hub.io.server import Hub
from glue.hub.session import _MAX_QUERIES
from glue.types import Action
from glue.wire.codec import TO_HUB, encode
from glue.wire.messages import Kind, Message, Role, Value
from tests.scripted.peer import GREETING, READY, TIMEOUT, ScriptedPeer, framed, hello_scalars

REQUESTS = 20
AGENT_STEP, ENV_STEP = b"\x94\x06", b"\x93\x0d"
"""First bytes of the headers of calls."""


class Rig:
    """A hub whose loop is turned by hand, and connections to it."""

    def __init__(self, stack: ExitStack) -> None:
        self.hub = stack.enter_context(
            Hub(HubConfig(bind=("tcp://127.0.0.1:*",), heartbeat=0.05, greeting=TIMEOUT))
        )
        self._stack = stack

    def connect(self, *sent: bytes) -> ScriptedPeer:
        """Return a connection that has sent its greeting and `sent`, all unread by the hub."""
        peer = self._stack.enter_context(ScriptedPeer(self.hub.endpoints[0]).connect())
        peer.socket.setblocking(False)
        peer.socket.send(b"".join((GREETING, READY, *sent)))
        return peer

    def turns_until(self, happened: Callable[[], bool]) -> int:
        """Turn the loop until something has happened; return the number of turns."""
        for turn in range(10_000):
            if happened():
                return turn
            self.hub.loop.turn()
        raise AssertionError("it does not happen")

    def join(self, role: Role, session: str) -> ScriptedPeer:
        """Return a connection of a peer that has joined a session."""
        peer = self.connect(frame(Kind.HELLO, session, 0, *hello_scalars(role)))
        self.turns_until(lambda: b"\x93\x41" in received(peer) or session in self.hub.sessions._by_name)
        return peer


def frame(kind: Kind, session: str, seq: int, *scalars: Value) -> bytes:
    return framed(*encode(Message(kind, session, seq, scalars), TO_HUB))


def received(peer: ScriptedPeer) -> bytes:
    """Return the bytes that have arrived; empty if there are none."""
    try:
        return peer.socket.recv(2**20)
    except BlockingIOError:
        return b""


@pytest.fixture
def rig() -> Iterator[Rig]:
    with ExitStack() as stack:
        yield Rig(stack)


class Victim:
    """A session that plays: its experiment asks the agent, then for the number of steps."""

    def __init__(self, rig: Rig) -> None:
        self._rig = rig
        self._agent = rig.join(Role.AGENT, "victim")
        self._experiment = rig.join(Role.EXPERIMENT, "victim")
        self._seq = 0
        self._calls = 0

    def _await(self, peer: ScriptedPeer) -> int:
        return self._rig.turns_until(lambda: b"victim" in received(peer))

    def play(self) -> list[int]:
        """Make the requests of the session; return the number of turns that each message took."""
        turns = []
        received(self._experiment)
        for _ in range(REQUESTS):
            self._seq += 2
            self._calls += 1
            self._experiment.send_bytes(frame(Kind.RL_AGENT_MESSAGE, "victim", self._seq))
            turns.append(self._await(self._agent))
            self._agent.send_bytes(frame(Kind.AGENT_MESSAGE, "victim", self._calls))
            turns.append(self._await(self._experiment))
            self._experiment.send_bytes(frame(Kind.RL_NUM_STEPS, "victim", self._seq + 1))
            turns.append(self._await(self._experiment))
        return turns


def malformed(rig: Rig) -> None:
    for _ in range(60):
        rig.connect(framed(b"noise") * 1000)


def endless(rig: Rig) -> None:
    for _ in range(4):
        rig.connect(b"\x01\x00" * 20_000)


def heartbeats(rig: Rig) -> None:
    rig.join(Role.AGENT, "other").socket.send(frame(Kind.HEARTBEAT, "other", 1) * 2000)


def hellos(rig: Rig) -> None:
    hello = hello_scalars("agent")
    rig.join(Role.EXPERIMENT, "other").socket.send(frame(Kind.HELLO, "another", 0, *hello) * 500)


def requests_ahead(rig: Rig) -> None:
    requests = [frame(Kind.RL_RETURN, "other", seq) for seq in range(1, 2000)]
    rig.join(Role.EXPERIMENT, "other").socket.send(b"".join(requests))


def queries(rig: Rig) -> list[ScriptedPeer]:
    """Let twelve experiments without players make requests that need none."""
    asking = []
    for number in range(12):
        asking.append(rig.join(Role.EXPERIMENT, f"{number}"))
        requests = [frame(Kind.RL_NUM_EPISODES, f"{number}", seq) for seq in range(1, 1000)]
        asking[-1].socket.send(b"".join(requests))
    return asking


def connections(rig: Rig) -> None:
    for _ in range(200):
        rig.connect().close()


@pytest.mark.parametrize(
    "attack",
    [malformed, endless, heartbeats, hellos, requests_ahead, queries, connections],
    ids=lambda f: f.__name__,
)
def test_a_session_that_plays_is_served_in_the_first_turn_beside_any_flood(
    rig: Rig, attack: Callable[[Rig], object]
) -> None:
    victim = Victim(rig)
    victim.play()
    attack(rig)
    assert victim.play() == [1] * (3 * REQUESTS)


def test_requests_that_need_no_player_take_no_more_than_the_queues_share(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    asking = queries(rig)
    for _ in range(len(asking) * _MAX_QUERIES):
        rig.hub.loop.turn()
    acted: list[Message] = []
    receive = rig.hub.sessions.receive

    def count(channel: Channel, message: Message, now: float) -> bool:
        acted.append(message)
        return receive(channel, message, now)

    monkeypatch.setattr(rig.hub.sessions, "receive", count)
    for _ in range(100):
        rig.hub.loop.turn()
    assert 0 < len(acted) <= 100, "at most one a turn"


@pytest.mark.parametrize("kind", [Kind.HEARTBEAT, Kind.RL_RETURN])
def test_a_turn_takes_one_message_of_a_session(rig: Rig, kind: Kind) -> None:
    peer = rig.join(Role.EXPERIMENT, "s")
    received(peer)
    peer.send_bytes(b"".join(frame(kind, "s", seq) for seq in range(1, 101)))
    answer = frame(kind, "s", 1)[2:5]
    for turn in range(1, 51):
        rig.hub.loop.turn()
        assert received(peer).count(answer) <= 1, f"turn {turn}"


def test_the_steps_that_follow_from_answers_received_together_leave_together(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    sessions = ("a", "b", "c")
    _, environment = (
        rig.connect(*(frame(Kind.HELLO, session, 0, *hello_scalars(role)) for session in sessions))
        for role in (Role.AGENT, Role.ENVIRONMENT)
    )
    for session in sessions:
        rig.join(Role.EXPERIMENT, session).send_bytes(frame(Kind.RL_STEP, session, 1))
    asked = bytearray()

    def stepping() -> bool:
        asked.extend(received(environment))
        return asked.count(ENV_STEP) == len(sessions)

    rig.turns_until(stepping)
    sent: list[bytes] = []
    send = Connection.send

    def note(self: Connection, data: bytes) -> None:
        sent.append(data)
        send(self, data)

    monkeypatch.setattr(Connection, "send", note)
    answers = (Message(Kind.ENV_STEP, session, 1, (1.0, False), Action().body) for session in sessions)
    environment.send_bytes(b"".join(framed(*encode(answer, TO_HUB)) for answer in answers))
    rig.turns_until(lambda: any(AGENT_STEP in data for data in sent))
    assert [data.count(AGENT_STEP) for data in sent if AGENT_STEP in data] == [len(sessions)]


class Holding:
    """A holder that records its eviction."""

    def __init__(self, memory: Memory, size: int, in_session: bool) -> None:
        self.in_session = in_session
        self.evicted = False
        memory.account(self, size)

    def evict(self, why: str) -> None:
        """Release all memory."""
        self.evicted = True


@pytest.mark.parametrize(("size", "first"), [(60, False), (2**17, True)], ids=["little", "much"])
def test_who_takes_part_in_no_session_is_evicted_first_if_it_holds_much(size: int, first: bool) -> None:
    memory = Memory(2**20)
    in_session, newcomer = Holding(memory, 2**20, True), Holding(memory, size, False)
    memory.enforce()
    assert (in_session.evicted, newcomer.evicted) == (not first, first)


def test_room_is_made_for_a_message_that_did_not_fit() -> None:
    memory = Memory(2**20)
    largest, other = Holding(memory, 2**19, True), Holding(memory, 2**18, True)
    assert memory.make_room(2**18)
    assert not memory.make_room(2**18 + 1)
    memory.enforce()
    assert (largest.evicted, other.evicted) == (True, False)
    assert memory.make_room(2**18 + 1)
