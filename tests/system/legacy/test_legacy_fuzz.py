"""Any bytes, in any state: the hub survives, other sessions continue, and memory is bounded."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator
from contextlib import suppress
from random import Random

import pytest

from glue.legacy.codec import FROM, HANDSHAKE
from glue.types import Action
from tests.glue.legacy.conversations import conversation
from tests.memory import taking_less_than
from tests.proof import size
from tests.system.conformance import FiveStepEnvironment, MirrorAgent
from tests.system.legacy.legacy_client import Connection, Id, pack
from tests.system.legacy.legacy_rig import Rig, gateway

ATTACKED = "attacked"
EMPTY = pack(Action())
TEXT = struct.pack(">I", 2) + b"hi"


class Arena:
    """A hub that survives all attacks, and an undisturbed session on it."""

    def __init__(self, rig: Rig) -> None:
        self.rig = rig
        self.attacked = ATTACKED
        rig.originals(MirrorAgent(), FiveStepEnvironment())
        self._bystander = rig.experiment()
        self._episodes = 0
        self._open: list[Connection] = []
        self._bystander.rl_init()

    def connect(self) -> Connection:
        connection = self.rig.connect(session=self.attacked)
        self._open.append(connection)
        return connection

    def join(self, role: Id) -> Connection:
        connection = self.connect()
        connection.send(role)
        return connection

    def check(self) -> None:
        """Check that the other session is undisturbed, and clear away the remains of the attack."""
        self._episodes += 1
        assert self._bystander.rl_episode(0) == 1
        assert self._bystander.rl_num_steps() == 5
        assert self._bystander.rl_num_episodes() == self._episodes
        for connection in self._open:
            with suppress(OSError):  # closed in the attack
                connection.reset()
        self._open.clear()
        self.rig.wait_until_empty(self.attacked)


@pytest.fixture(scope="module")
def arena() -> Iterator[Arena]:
    with gateway("default", ATTACKED, *FLOODS) as rig:
        yield Arena(rig)


# Each scene returns the connection that attacks, in a certain state.

Scene = Callable[[Arena], Connection]


def idle(role: Id) -> Scene:
    return lambda arena: arena.join(role)


def asked(role: Id, request: Id, payload: bytes, call: Id) -> Scene:
    """Return a scene: a player at work on `call`, because an experiment made `request`."""

    def scene(arena: Arena) -> Connection:
        player = arena.join(role)
        arena.join(Id.EXPERIMENT_CONNECTION).send(request, payload)
        assert player.receive()[0] == call
        return player

    return scene


def under_way(arena: Arena) -> tuple[Connection, Connection]:
    """Return an agent and an experiment that has asked for its action."""
    agent, glue = arena.join(Id.AGENT_CONNECTION), arena.join(Id.EXPERIMENT_CONNECTION)
    glue.send(Id.RL_AGENT_START, EMPTY)
    agent.receive()
    return agent, glue


def dismissed(arena: Arena) -> Connection:
    """An agent whose answer is no longer needed."""
    agent, glue = under_way(arena)
    glue.reset()
    return agent


def abandoned(arena: Arena) -> Connection:
    agent, glue = arena.join(Id.AGENT_CONNECTION), arena.join(Id.EXPERIMENT_CONNECTION)
    glue.close()
    assert agent.receive() == (Id.RL_TERM, b"")
    return agent


AGENT, ENVIRONMENT, EXPERIMENT = Id.AGENT_CONNECTION, Id.ENVIRONMENT_CONNECTION, Id.EXPERIMENT_CONNECTION
SCENES: dict[str, Scene] = {
    "without a role": Arena.connect,
    "agent, idle": idle(AGENT),
    "agent, step": asked(AGENT, Id.RL_AGENT_STEP, bytes(8) + EMPTY, Id.AGENT_STEP),
    "agent, message": asked(AGENT, Id.RL_AGENT_MESSAGE, TEXT, Id.AGENT_MESSAGE),
    "agent, dismissed": dismissed,
    "agent, abandoned": abandoned,
    "environment, idle": idle(ENVIRONMENT),
    "environment, start": asked(ENVIRONMENT, Id.RL_START, b"", Id.ENV_START),
    "experiment, idle": idle(EXPERIMENT),
    "experiment, waiting": lambda arena: under_way(arena)[1],
}


@pytest.mark.proof
@pytest.mark.parametrize("scene", SCENES)
def test_any_bytes_leave_the_hub_and_other_sessions_unharmed(arena: Arena, scene: str) -> None:
    spoken = (HANDSHAKE, *FROM.values())
    # An experiment whose data ends may be owed replies, and stays until the hub's timeout.
    may_be_owed = scene.startswith(("experiment", "without"))
    ends = ["", "reset"] if may_be_owed else ["", "reset", "close", "close_writing"]
    for seed in range(size(4, 200)):
        random = Random(f"{scene} {seed}")
        data = b"".join(conversation(random, random.choice(spoken))) + random.randbytes(
            random.choice([0, 40])
        )
        connection = SCENES[scene](arena)
        with suppress(OSError):  # the hub may drop the connection in the middle
            connection.send_raw(data[random.choice([0, 0, 0, 1]) : len(data) - random.choice([0, 0, 1, 7])])
            if end := random.choice(ends):
                getattr(connection, end)()
        arena.check()


LONGEST = 12 + 13 * 1_000_000
"""The longest abstract type that an original program may send, in bytes."""

FLOODS = {
    "agent, step": (struct.pack(">iI", Id.AGENT_STEP, LONGEST), LONGEST),
    "experiment, idle": (struct.pack(">iI", Id.RL_ENV_STEP, LONGEST), LONGEST),
    "experiment, waiting": (struct.pack(">iI", Id.RL_NUM_STEPS, 0) * 8192, 2**20),
    "without a role": (struct.pack(">iI", AGENT, 65_536), 65_536),
}
"""Data to send repeatedly, or before endless zeros, and the number of bytes of it that may be held."""


@pytest.mark.parametrize("scene", FLOODS)
def test_a_flood_takes_no_more_memory_than_the_longest_legal_message(arena: Arena, scene: str) -> None:
    data, held = FLOODS[scene]
    data += data * 400 if len(data) > 8 else bytes(2 * LONGEST)
    # The hub reads the rest of a flood before it counts the peer as gone: each needs a session of its own.
    arena.attacked = scene
    connection = SCENES[scene](arena)
    arena.rig.settle()
    sent = 0
    # A whole message is copied twice while it is read; the rest is for the test itself.
    with taking_less_than(int(3.5 * held) + 4 * 2**20), suppress(OSError):  # a flood that is too large
        while more := connection.flood(data[sent : sent + 2**20]):
            sent += more
            arena.rig.settle()
    assert sent > 2**16
    arena.check()
