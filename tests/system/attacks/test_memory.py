"""Whatever peers make a hub keep, its process holds no more than its limit and a little beside it.

That a session accounts for every body that it keeps is weighed in `tests/glue/hub/test_memory.py`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack, suppress
from pathlib import Path

import pytest

from glue.types import Observation
from glue.wire.codec import FROM_HUB, decode
from glue.wire.messages import CALLS, MAX_BODY, Kind, Message
from tests.scripted.peer import ScriptedPeer
from tests.system.attacks import siege
from tests.system.attacks.attacker import client_of
from tests.system.attacks.siege import make_keys
from tests.system.attacks.victim import Victim, victim


class Attack:
    """Peers of one hub, which read only what they are told to.

    Args:
        url: address of the hub.
        stack: closes the connections.
        size: size of the largest bodies that the hub takes, in bytes.
        keys: the keys of the peers; empty if nothing is encrypted.
    """

    def __init__(self, url: str, stack: ExitStack, size: int, keys: tuple[str, ...]) -> None:
        self._url = url
        self._stack = stack
        self._keys = keys
        self.huge = Observation(chars=bytes(size - 16)).body

    def peer(self, role: str, *sessions: str, reads: bool = True) -> Peer:
        """Let a peer join sessions."""
        buffer = 0 if reads else 4096
        peer = self._stack.enter_context(Peer(self._url, client_of(self._keys), receive_buffer=buffer))
        peer.greet()
        peer.session = sessions[0]
        for session in sessions:
            peer.hello(role, session=session)
            while peer.following().kind is not Kind.WELCOME:
                pass
        return peer

    def session(self, *names: str) -> tuple[Peer, Peer, Peer]:
        """Return the environment, the agent and the experiment of sessions."""
        return self.peer("environment", *names), self.peer("agent", *names), self.peer("experiment", *names)


class Peer(ScriptedPeer):
    """A peer that answers calls on request."""

    def answer(self, body: bytes = b"", *scalars: float) -> None:
        """Answer the next call; AGENT_END is never answered."""
        while (call := self.following()).kind not in CALLS or call.kind is Kind.AGENT_END:
            pass
        self.say(call.kind, call.seq, *scalars, body=body, session=call.session)

    def wait(self) -> None:
        """Wait until the hub has acted on everything that this peer has sent."""
        self.say(Kind.HEARTBEAT, 77)
        while self.following().seq != 77:
            pass

    def following(self) -> Message:
        """Return the next message of any kind; raise ConnectionError once the session is over."""
        message = decode(self.receive_frames(), FROM_HUB)
        assert message.kind is not Kind.REFUSE, message
        if message.kind in (Kind.GOODBYE, Kind.ERROR):
            raise ConnectionError("the hub has ended the session")
        return message


def watched(attack: Attack, name: str) -> tuple[Peer, Peer, Peer]:
    """Return the peers of a session that eight observers watch without reading."""
    environment, agent, experiment = attack.session(name)
    for _ in range(8):
        observer = attack.peer("observer", name, reads=False)
        observer.say(Kind.OBSERVE, 0, 2**62)
        observer.wait()
    return environment, agent, experiment


def observers_of_a_step(attack: Attack, name: str) -> None:
    environment, _, experiment = watched(attack, name)
    experiment.say(Kind.RL_ENV_STEP, 1, body=attack.huge)
    environment.answer(attack.huge, 1.0, False)
    environment.wait()


def experiment_that_does_not_read(attack: Attack, name: str) -> None:
    environment, agent = attack.peer("environment", name), attack.peer("agent", name)
    experiment = attack.peer("experiment", name, reads=False)
    experiment.say(Kind.RL_START, 1)
    environment.answer(attack.huge)
    agent.answer(attack.huge)
    agent.wait()


def agent_that_does_not_read(attack: Attack, name: str) -> None:
    attack.peer("agent", name, reads=False)
    experiment = attack.peer("experiment", name)
    experiment.say(Kind.RL_AGENT_START, 1, body=attack.huge)
    experiment.wait()


def light_sessions(attack: Attack, name: str) -> None:
    """Sessions that keep a task spec, an action and observations of moderate size."""
    body = Observation(chars=bytes(50_000)).body
    every = [f"{name}-{number}" for number in range(32)]
    environment, agent, experiment = attack.session(*every)
    for each in every:
        experiment.say(Kind.RL_INIT, 1, None, session=each)
        environment.answer(body)
        agent.answer()
        while experiment.following().kind is not Kind.RL_INIT:
            pass
        experiment.say(Kind.RL_EPISODE, 2, 0, session=each)
        environment.answer(body)
        agent.answer(body)
        environment.answer(body, 1.0, True)
    environment.wait()


def half_a_message(attack: Attack, name: str) -> Peer:
    agent = attack.peer("agent", name)
    agent.send_bytes(agent.encoded(*agent.frames_of(Kind.AGENT_MESSAGE, 1, body=attack.huge))[:-1])
    return agent


def half_a_message_before_leaving(attack: Attack, name: str) -> None:
    half_a_message(attack, name).close()


ATTACKS: dict[Callable[[Attack, str], object], int] = {
    observers_of_a_step: 1,
    experiment_that_does_not_read: 6,
    agent_that_does_not_read: 10,
    light_sessions: 12,
    half_a_message: 10,
    half_a_message_before_leaving: 10,
}
"""The attacks, and in how many sessions each is made."""


def attacked(
    hub: Victim, attack: Callable[[Attack, str], object], size: int, keys: tuple[str, ...] = ()
) -> int:
    """Carry out an attack in several sessions; return by how much the hub's memory grew at most, in bytes."""
    before = hub.begin()
    with ExitStack() as stack:
        peers = Attack(hub.url, stack, size, keys)
        for number in range(ATTACKS[attack]):
            with suppress(OSError):  # the hub has dropped who uses most
                attack(peers, f"m{number}")
    return hub.most() - before


LIMIT, BODY, BESIDE = 16 * 2**20, 4 * 2**20, 12 * 2**20
"""The limit of a hub, the size of its largest body, and what it may use besides its limit, in bytes."""


@pytest.fixture(scope="module")
def small() -> Iterator[Victim]:
    with victim(max_memory=LIMIT, max_body=BODY) as hub:
        yield hub


@pytest.mark.parametrize("attack", ATTACKS, ids=lambda attack: attack.__name__)
def test_the_memory_of_a_hub_is_bounded(small: Victim, attack: Callable[[Attack, str], object]) -> None:
    assert attacked(small, attack, BODY) <= LIMIT + BESIDE


def test_no_message_is_encrypted_for_which_there_is_no_room(tmp_path: Path) -> None:
    folder, _, keys = make_keys(tmp_path)
    with victim(keys=folder, max_memory=LIMIT, max_body=BODY) as hub:
        assert attacked(hub, experiment_that_does_not_read, BODY, keys) <= LIMIT + BESIDE


@pytest.mark.stage("attacks")
@pytest.mark.parametrize("attack", ATTACKS, ids=lambda attack: attack.__name__)
@pytest.mark.parametrize("keyed", [False, True], ids=["without keys", "with keys"])
def test_the_memory_of_a_hub_is_bounded_with_the_largest_messages(
    attack: Callable[[Attack, str], object], keyed: bool, tmp_path: Path
) -> None:
    folder, _, keys = make_keys(tmp_path) if keyed else (None, {}, ())
    with victim(keys=folder, max_memory=siege.LIMIT) as hub:
        assert attacked(hub, attack, MAX_BODY, keys) <= siege.LIMIT + siege.BESIDE
