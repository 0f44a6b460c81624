"""`glue-env mario --batch N` shows, to the byte, the same as N environments with the same options."""

from __future__ import annotations

from collections.abc import Iterator
from threading import Thread
from typing import Any, Final

import numpy as np
import pytest

from env_server.cli.environment import environment as glue_env
from env_server.mario.environment import InfiniteMario
from env_server.mario.many.environment import InfiniteMarioBatch
from glue import Action, Environment, Observation, connect, make
from glue.batches import Ragged, pack_actions, read_batch_task_spec, unpack_batch
from glue.console import LOG
from glue.errors import ConfigError, GlueError, RemoteProtocolError, SimulatorError
from glue.plugins.batched import BatchedEnvironments, make_batch
from tests.hubs import hub_with
from tests.players import ActingInAll

STEPS: Final = 40
LIVELY: Final[dict[str, Any]] = {"level_difficulty": 9, "max_trial_steps": 25}
"""Options of games that end, each at a different step."""
Shown = tuple[float, bytes]
"""The sum of the rewards, and the message."""


def actions(games: int) -> Iterator[Action]:
    """Yield the actions of STEPS steps, mostly running to the right."""
    generator = np.random.default_rng(games)
    for _ in range(STEPS):
        direction = generator.choice([-1, 0, 1], games, p=[0.1, 0.1, 0.8])
        buttons = generator.integers(0, 2, (2, games))
        rows = np.stack([direction, *buttons], 1).tolist()
        yield pack_actions(Ragged.of([Action(row) for row in rows]))


def played(environment: Environment, games: int) -> list[Shown]:
    shown = [(0.0, environment.env_start().body)]
    for action in actions(games):
        reward, observation, terminal, *_ = environment.env_step(action)
        assert terminal is False
        shown.append((reward, observation.body))
    return shown


def both(games: int, **options: Any) -> tuple[Environment, Environment]:
    """Return the compiled batch, and a batch of as many separate environments."""
    many = BatchedEnvironments([InfiniteMario(**options) for _ in range(games)])
    return make_batch("mario", lambda: InfiniteMario(**options), games), many


@pytest.mark.parametrize("games", [1, 3, 64])
def test_games_are_shown_as_so_many_environments_show_them(games: int) -> None:
    ours, theirs = both(games, **LIVELY)
    assert isinstance(ours, InfiniteMarioBatch)
    for _ in range(2):  # fresh games after another init
        assert ours.env_init() == theirs.env_init()
        shown = played(ours, games)
        assert shown == played(theirs, games)
    ended = [unpack_batch(Observation.from_body(body)).terminals.sum() for _, body in shown]
    assert sum(ended) >= games
    assert games == 1 or any(0 < some < games for some in ended)


def test_messages_are_answered_as_one_environment_answers_them() -> None:
    ours, theirs = both(3, **LIVELY)
    questions = ["parameters", "level", "level level_seed=9 level_type=2", "level", "level level_seed=x", ""]
    for environment in (ours, theirs):
        environment.env_init()
    for part in (questions, ["level level_seed=11 level_difficulty=4", "jump"]):
        for question in part:
            assert ours.env_message(question) == theirs.env_message(question)
        assert played(ours, 3) == played(theirs, 3)
    for environment in (ours, theirs):
        environment.env_cleanup()
    for question in reversed(questions):
        assert ours.env_message(question) == theirs.env_message(question)
    assert ours.env_init() == theirs.env_init()
    assert played(ours, 3) == played(theirs, 3)


def test_what_cannot_be_carried_out_moves_no_game() -> None:
    ours, theirs = both(3)
    with pytest.raises(SimulatorError, match="env_init"):
        ours.env_start()
    ours.env_init(), theirs.env_init()
    good = next(actions(3))
    with pytest.raises(SimulatorError, match="game 0 has no episode"):
        ours.env_step(good)
    assert ours.env_start() == theirs.env_start()
    wrong: list[tuple[list[Action], type[GlueError], str]] = [
        ([Action([1, 0, 1])] * 2 + [Action([1, 2, 1])], SimulatorError, "game 2"),
        ([Action([1, 0, 1]), Action([1, 0]), Action([1, 0, 1])], SimulatorError, "game 1: .* 3 ints"),
        ([Action([1, 0, 1])] * 2, RemoteProtocolError, "actions of 3 games"),
    ]
    for given, kind, words in wrong:
        with pytest.raises(kind, match=words):
            ours.env_step(pack_actions(Ragged.of(given)))
    with pytest.raises(RemoteProtocolError, match="actions of 3 games"):
        ours.env_step(Action([1, 0, 1]))
    assert ours.env_step(good) == theirs.env_step(good)


def test_more_games_than_any_message_holds_are_refused() -> None:
    for games in (0, 10**9):
        with pytest.raises(ConfigError, match="1 to 41943"):
            make_batch("mario", InfiniteMario, games)


class Runner(ActingInAll):
    """Runs to the right in all games, and keeps its observations."""

    def __init__(self) -> None:
        self.shown: list[bytes] = []

    def agent_start(self, observation: Observation) -> Action:
        self.shown.append(observation.body)
        return pack_actions(Ragged.of([Action([1, 0, 1])] * self.games))


def test_the_command_serves_many_games_as_one() -> None:
    agent, level = Runner(), LOG.level
    alone = make("mario", **LIVELY)
    alone.env_init()
    expected = [alone.env_start(), *(alone.env_step(Action([1, 0, 1]))[1] for _ in range(4))]
    with hub_with(agent) as hub:
        options = [f"--{name.replace('_', '-')}={value}" for name, value in LIVELY.items()]
        arguments = ["mario", *options, "--batch", "3", "--hub", hub, "--quiet"]
        serving = Thread(target=glue_env.main, args=(arguments,), kwargs={"standalone_mode": False})
        serving.start()
        with connect(hub) as glue:
            assert read_batch_task_spec(glue.rl_init())[0] == 3
            glue.rl_episode(max_steps=5)
    serving.join()
    assert LOG.level == level  # --quiet ends with the command
    shown = [unpack_batch(Observation.from_body(body)).observations for body in agent.shown]
    assert [one.values(Observation) for one in shown] == [[one] * 3 for one in expected]
