"""Many games in one session: the bytes, ends and cut-offs, and the capability."""

from __future__ import annotations

import socket
from collections.abc import Callable
from contextlib import AbstractContextManager

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from env_server.toys import MinesEnvironment
from glue import Action, Agent, Environment, Observation, local
from glue.batches import (
    Batch,
    Ragged,
    batch_task_spec,
    pack_actions,
    pack_batch,
    read_batch_task_spec,
    unpack_actions,
    unpack_batch,
)
from glue.client.sockets import SocketTransport
from glue.engine.experiment import Experiment
from glue.errors import ConfigError, GlueError, PeerFailed, RemoteProtocolError, Unsupported
from glue.hub.config import Bind
from glue.hub.io.loop import READ, Loop
from glue.plugins.batched import BatchedEnvironments
from glue.roles import capabilities
from glue.system.spinning import LONG_SPIN_SECONDS, SPIN_SECONDS
from glue.types import Step
from glue.wire.messages import Kind, Role
from tests.glue.engine.test_local import Countdown
from tests.hubs import over_the_hub, running
from tests.pages import DOCS, blocks, section
from tests.players import ActingInAll, ScriptedAgent, ScriptedEnvironment
from tests.scripted.peer import ScriptedPeer

Glue = Callable[[Agent, Environment], AbstractContextManager[Experiment]]
PROTOCOL = (DOCS / "protocol-reference.md").read_text(encoding="utf-8")

VALUES = st.builds(
    Observation,
    st.lists(st.integers(-(2**31), 2**31 - 1), max_size=3),
    st.lists(st.floats(), max_size=3),
    st.binary(max_size=5),
)


def documented() -> list[bytes]:
    """Return the bodies shown in the section on batches."""
    shown = [block.body for block in blocks(section(PROTOCOL, "Batches"), "body")]
    return [bytes.fromhex("".join(line.split(";")[0] for line in body.splitlines())) for body in shown]


def test_examples_of_the_document_are_what_the_program_packs() -> None:
    observation, action = documented()
    shown = Ragged.of([Observation([number]) for number in (7, 10, 10, 9)])
    batch = Batch(np.array([0.5, 1.0, 0.25]), np.array([0, 1, 2], np.int32), shown)
    assert pack_batch(batch).body == observation
    assert pack_actions(Ragged.of([Action([number]) for number in (1, 0, 1)])).body == action


@given(st.lists(st.tuples(st.sampled_from([0, 1, 2]), st.floats(), VALUES, VALUES), min_size=1, max_size=5))
def test_a_batch_survives_the_way(games: list[tuple[int, float, Observation, Observation]]) -> None:
    terminals = np.array([terminal for terminal, *_ in games], np.int32)
    rewards = np.array([reward for _, reward, *_ in games])
    values = [first for *_, first, _ in games] + [last for terminal, *_, last in games if terminal == 2]
    batch = unpack_batch(pack_batch(Batch(rewards, terminals, Ragged.of(values))))
    assert batch.rewards.tobytes() == rewards.tobytes()
    assert batch.terminals.tolist() == terminals.tolist()
    assert batch.observations.values(Observation) == values
    actions = [Action.from_body(value.body) for value in values]
    assert unpack_actions(pack_actions(Ragged.of(actions)), len(actions)).values(Action) == actions


@given(st.lists(st.integers(-3, 12), max_size=14), st.integers(0, 4), st.integers(0, 4))
def test_what_is_no_batch_is_refused_or_whole(ints: list[int], doubles: int, chars: int) -> None:
    value = Observation(ints, [0.0] * doubles, bytes(chars))
    try:
        batch = unpack_batch(value)
    except RemoteProtocolError:
        return
    assert pack_batch(batch) == value
    batch.observations.values(Observation)


def test_actions_for_another_number_of_games_are_refused() -> None:
    action = pack_actions(Ragged.of([Action([1])] * 3))
    for games in (1, 2, 4):
        with pytest.raises(RemoteProtocolError, match=f"actions of {games} games"):
            unpack_actions(action, games)


def test_task_spec_of_a_batch_holds_that_of_each_game() -> None:
    assert read_batch_task_spec(batch_task_spec(64, "VERSION x 1")) == (64, "VERSION x 1")
    for wrong in (
        "",
        "VERSION RL-Glue-Batch-1 x y",
        "VERSION RL-Glue-Batch-1 0 y",
        "VERSION RL-Glue-3.0",
        f"VERSION RL-Glue-Batch-1 {'9' * 5000} x",
    ):
        with pytest.raises(RemoteProtocolError):
            read_batch_task_spec(wrong)


class Vector(ActingInAll):
    """Records each batch, and answers observation n with the action n + 100 in every game."""

    def __init__(self) -> None:
        self.seen: list[tuple[list[float], list[int], list[int]]] = []

    def agent_start(self, observation: Observation) -> Action:
        batch = unpack_batch(observation)
        shown = [int(one.ints[0]) for one in batch.observations.values(Observation)]
        self.seen.append((batch.rewards.tolist(), batch.terminals.tolist(), shown))
        return pack_actions(Ragged.of([Action([number + 100]) for number in shown[: self.games]]))


@pytest.mark.parametrize("glue", [local, over_the_hub])
def test_games_begin_anew_inside_the_batch(glue: Glue) -> None:
    games = [ScriptedEnvironment(length=2, reward=1.0), ScriptedEnvironment(length=3, reward=0.5)]
    games[1].cuts = True
    agent = Vector()
    with glue(agent, BatchedEnvironments(games)) as experiment:
        experiment.rl_init(1)
        assert experiment.rl_episode(max_steps=5) is False
        assert experiment.rl_return() == 4 * 1.5
        experiment.rl_cleanup()
    assert agent.seen == [
        ([0.0, 0.0], [0, 0], [0, 0]),
        ([1.0, 0.5], [0, 0], [1, 1]),
        ([1.0, 0.5], [1, 0], [0, 2]),
        ([1.0, 0.5], [0, 2], [1, 0, 3]),
        ([1.0, 0.5], [1, 0], [0, 1]),
    ]
    steps = [call for call in games[1].calls if call.startswith("env_step")]
    assert steps == ["env_step [100]", "env_step [101]", "env_step [102]", "env_step [100]"]


@pytest.mark.parametrize("glue", [local, over_the_hub])
def test_an_agent_for_single_games_is_refused_by_name(glue: Glue) -> None:
    environment = BatchedEnvironments([ScriptedEnvironment()])
    with glue(ScriptedAgent(), environment) as experiment, pytest.raises(Unsupported, match="agent_batch"):
        experiment.rl_init()


def test_peers_of_many_games_spin_longer_before_they_sleep(monkeypatch: pytest.MonkeyPatch) -> None:
    spun: list[float] = []
    monkeypatch.setattr("glue.system.spinning.SEVERAL_CORES", True)
    monkeypatch.setattr(SocketTransport, "spin_with", lambda transport, spin: spun.append(spin.seconds))
    monkeypatch.setattr(Loop, "spin_longer", lambda loop: spun.append(0.0))
    with over_the_hub(ScriptedAgent(), ScriptedEnvironment()) as experiment:
        experiment.rl_init()
    assert spun == [SPIN_SECONDS, SPIN_SECONDS]
    spun.clear()
    with over_the_hub(Vector(), BatchedEnvironments([ScriptedEnvironment()])) as experiment:
        experiment.rl_init()
    assert sorted(spun) == [0.0, 0.0, LONG_SPIN_SECONDS, LONG_SPIN_SECONDS]


def test_a_peer_that_is_refused_makes_no_hub_spin(monkeypatch: pytest.MonkeyPatch) -> None:
    spun: list[Loop] = []
    monkeypatch.setattr(Loop, "spin_longer", lambda loop: spun.append(loop))
    no_agents = Bind("tcp://127.0.0.1:*", roles=frozenset({Role.ENVIRONMENT}))
    with running(bind=no_agents) as hub, ScriptedPeer(hub.endpoints[0]).greet() as peer:
        peer.hello("agent", abilities=("batch",))
        assert peer.receive().kind is Kind.REFUSE
        peer.hello("environment", abilities=("batch",))
        assert peer.receive().kind is Kind.WELCOME
        peer.hello("agent")  # when it is answered, the others have been dealt with
        assert peer.receive().kind is Kind.REFUSE
    assert len(spun) == 1


class Answering:
    """A source of events whose answer arrives after 50 polls."""

    def __init__(self, loop: Loop) -> None:
        self.looks = 0
        self._loop = loop

    def glance(self) -> bool | None:
        self.looks += 1
        return True if self.looks == 50 else None

    def turn(self, now: float) -> None:
        self._loop.stop("it arrived")


def test_a_hub_that_expects_an_answer_does_not_sleep_meanwhile(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("glue.hub.io.loop.LONG_SPIN_SECONDS", 60.0)
    monkeypatch.setattr("glue.system.spinning._LOST_SECONDS", 60.0)
    loop = Loop(60.0, lambda line: None)
    ours, theirs = socket.socketpair()
    with ours, theirs:
        source = Answering(loop)
        loop.watch(ours.fileno(), READ, source)
        loop.spin_longer()
        loop.expect(source)
        loop.turn()  # would sleep until the tick
        loop.unwatch(ours.fileno())
    assert (loop.stopping, source.looks) == ("it arrived", 50)
    loop.close()


def test_a_batch_needs_environments_with_one_task_spec() -> None:
    with pytest.raises(ConfigError, match="at least one"):
        BatchedEnvironments([])
    other = ScriptedEnvironment()
    other.task_spec = "another"
    with pytest.raises(ConfigError, match="one task spec"):
        BatchedEnvironments([ScriptedEnvironment(), other]).env_init()
    assert capabilities(BatchedEnvironments([other])) == ("batch", "seed", "truncate")


def test_games_of_a_batch_are_checked_as_single_ones_are() -> None:
    class Blurred(MinesEnvironment):
        def env_step(self, action: Action) -> Step:
            return Step(0.0, Observation(doubles=[0.5]), False)

    batch = BatchedEnvironments([MinesEnvironment(), Blurred()])
    batch.env_init()
    batch.env_start()
    with pytest.raises(PeerFailed, match="game 1: env_step of Blurred"):
        batch.env_step(pack_actions(Ragged.of([Action([1])] * 2)))
    plain = BatchedEnvironments([Countdown(None)])
    plain.env_init()
    plain.env_start()
    assert plain.env_message("?") == ""
    plain.env_cleanup()


def test_games_of_a_batch_are_seeded_apart_and_play_as_alone() -> None:
    games, alone = ([MinesEnvironment(random_start=True) for _ in range(8)] for _ in range(2))
    batch = BatchedEnvironments(games)

    def start() -> list[Observation]:
        batch.env_seed(3)
        for one, game in zip(alone, games, strict=True):
            one.env_load(game.env_save())  # seeded as the batch has seeded it
        assert read_batch_task_spec(batch.env_init()) == (8, alone[0].env_init())
        return unpack_batch(batch.env_start()).observations.values(Observation)

    shown = start()
    assert len({int(one.ints[0]) for one in shown}) == 8
    assert start() == shown == [one.env_start() for one in alone]
    actions = [Action([game % 4]) for game in range(8)]
    steps = [one.env_step(action) for one, action in zip(alone, actions, strict=True)]
    assert not any(step.terminal for step in steps)
    reward, observation, terminal, *_ = batch.env_step(pack_actions(Ragged.of(actions)))
    assert (reward, terminal) == (sum(step.reward for step in steps), False)
    assert unpack_batch(observation).observations.values(Observation) == [step.observation for step in steps]
    with pytest.raises(GlueError):
        batch.env_step(Action([1]))
