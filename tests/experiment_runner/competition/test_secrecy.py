"""Only actions, observations and rewards pass between an entrant and its environment."""

from __future__ import annotations

import struct
import threading
from collections.abc import Iterator
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Annotated, Any, ClassVar

import pytest

from env_server.toys import MinesEnvironment
from experiment_runner.competition.launching import Launch, variables
from experiment_runner.competition.settings import Limits
from experiment_runner.competition.trials import trials
from experiment_runner.executors.job import Ended
from glue.engine.engine import role_seed
from glue.hub.config import HubConfig
from glue.options import Option
from glue.types import Action, Observation, Step
from glue.wire.codec import FROM_HUB, TO_HUB, decode
from glue.wire.messages import CALLS, Body, Kind, Role
from tests.experiment_runner.competition.players import SECRET, InThread, Thread, competition, reports_of
from tests.scripted.peer import ScriptedPeer, hello_scalars

CANARY = "sings in the mine"

ASKED = {
    *(Kind.AGENT_SEED, Kind.AGENT_INIT, Kind.AGENT_START, Kind.AGENT_STEP, Kind.AGENT_END),
    *(Kind.AGENT_CLEANUP, Kind.AGENT_MESSAGE),
}
"""Calls that an agent receives in a competition: no message but what time is left, and no save."""

TO_KEEP_UP = {Kind.WELCOME, Kind.HEARTBEAT, Kind.GOODBYE}

SMUGGLED = [
    *(Kind.ENV_MESSAGE, Kind.RL_ENV_MESSAGE, Kind.RL_AGENT_MESSAGE, Kind.AGENT_MESSAGE, Kind.NOTICE),
    *(Kind.ENV_STEP, Kind.ENV_SEED, Kind.RL_ENV_LOAD, Kind.RL_STEP),
]


class Listening(MinesEnvironment):
    """Mines on a level of a secret seed, with every capability; records the calls it receives."""

    heard: ClassVar[list[str]] = []

    def __init__(self, level_seed: Annotated[int, Option("which level", low=0)] = 0) -> None:
        super().__init__(random_start=True)

    def env_init(self) -> str:
        self.heard.append("init")
        return super().env_init()

    def env_seed(self, seed: int) -> None:
        self.heard.append("seed")
        super().env_seed(seed)

    def env_start(self) -> Observation:
        self.heard.append("start")
        return super().env_start()

    def env_step(self, action: Action) -> Step:
        self.heard.append("step")
        assert (len(action.ints), len(action.doubles), bytes(action.chars)) == (1, 0, b"")
        return super().env_step(action)

    def env_message(self, message: str) -> str:
        self.heard.append(f"message {message}")
        return CANARY

    def env_save(self) -> bytes:
        self.heard.append("save")
        return b""

    def env_load(self, data: bytes) -> None:
        self.heard.append("load")


class RawAgent:
    """An entrant that keeps every byte it receives, and once sends a message of its choice."""

    def __init__(self, action: Action, smuggled: Kind | None = None) -> None:
        self.action = action
        self.smuggled = smuggled
        self.received: list[bytes] = []
        self.kinds: set[Kind] = set()

    def serve(self, launch: Launch, over: threading.Event) -> None:
        with ScriptedPeer(launch.hub, session=launch.session).greet() as peer:
            peer.say(Kind.HELLO, 0, *hello_scalars("agent", CANARY, ("seed", "save")))
            with suppress(ConnectionAbortedError):  # the hub is closed before `stop`
                while not over.is_set():
                    if peer.can_read(0.05):
                        self._take(peer)

    def _take(self, peer: ScriptedPeer) -> None:
        frames = peer.receive_frames()
        self.received += frames
        kind, session, seq, _, _ = decode(frames, FROM_HUB)
        self.kinds.add(kind)
        if kind not in CALLS:
            return
        if kind is Kind.AGENT_STEP and self.smuggled is not None:
            self._smuggle(self.smuggled, peer)
            self.smuggled = None
        acts = CALLS[kind].reply.body is Body.ACTION
        body = self.action.body if acts else b""
        peer.say(kind, seq, body=body, session=session)

    @staticmethod
    def _smuggle(kind: Kind, peer: ScriptedPeer) -> None:
        """Send a well-formed message that its sender may not send."""
        scalars: dict[type, Any] = {int: 1, float: 1.0, bool: True, str: CANARY, bytes: CANARY.encode()}
        shape = TO_HUB[kind]
        values = tuple(scalars.get(scalar.type, ()) for scalar in shape.scalars)
        body = Action(chars=CANARY.encode()).body if shape.body is Body.ACTION else CANARY.encode()
        peer.say(kind, 1, *values, body=body if shape.body else b"")


class Raw(Thread):
    """A thread in which a RawAgent serves until it is stopped."""

    def __init__(self, agent: Any, launch: Launch) -> None:
        self._over = threading.Event()
        super().__init__(agent, launch)

    def _serve(self) -> None:
        self._agent.serve(self._launch, self._over)

    def stop(self) -> None:
        self._over.set()
        self._thread.join()


@pytest.fixture
def heard(monkeypatch: pytest.MonkeyPatch) -> Iterator[list[str]]:
    patient = partial(HubConfig, greeting=60.0)  # the entrant connects only once
    monkeypatch.setattr("experiment_runner.competition.match.HubConfig", patient)
    Listening.heard.clear()
    yield Listening.heard
    Listening.heard.clear()


ENV = f"{__name__}:Listening"
LIMITS = Limits(start_seconds=10.0)


def test_no_message_passes_to_an_entrant_or_its_environment_and_no_seed(
    heard: list[str], tmp_path: Path
) -> None:
    agent = RawAgent(Action(ints=[1]))
    launcher = InThread(agent, Raw)
    reports = reports_of(launcher, tmp_path, env=ENV, limits=LIMITS)
    assert not reports.forfeit
    assert set(heard) == {"seed", "init", "start", "step"}
    assert agent.kinds - TO_KEEP_UP == ASKED  # also its own seed, which reveals nothing of these
    (launch,) = launcher.launches
    told = (str(launch.folder), *variables(launch.hub, launch.session).values())
    seen = b"\n".join([*agent.received, *map(str.encode, told)])
    for secret in (CANARY.encode(), *secrets()):
        assert secret not in seen


@pytest.mark.parametrize("kind", SMUGGLED)
def test_what_an_entrant_smuggles_in_does_not_reach_its_environment(
    kind: Kind, heard: list[str], tmp_path: Path
) -> None:
    agent = RawAgent(Action(ints=[1]), smuggled=kind)
    reports = reports_of(InThread(agent, Raw), tmp_path, env=ENV, limits=LIMITS, steps=10)
    assert agent.smuggled is None
    assert reports[-1] == Ended(None)
    assert set(heard) <= {"seed", "init", "start", "step"}
    assert heard.count("step") <= 10
    assert agent.kinds <= ASKED | TO_KEEP_UP | {Kind.ERROR}
    assert not any(CANARY.encode() in frame for frame in agent.received)


def secrets() -> Iterator[bytes]:
    """Yield the secret, and the numbers drawn from it for the environment, in every usual form."""
    (spec,) = trials(competition("alice", env=ENV), SECRET)
    assert spec.environment is not None
    yield SECRET
    for number in (spec.seed, role_seed(spec.seed, Role.ENVIRONMENT), spec.environment.options["level_seed"]):
        assert isinstance(number, int)
        yield from (str(number).encode(), f"{number:x}".encode())
        for form in ("<Q", ">Q") if number >= 2**32 else ("<I", ">I"):
            yield struct.pack(form, number)
        yield struct.pack("<d", number)
