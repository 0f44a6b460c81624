"""Calls of tools as a client of the Model Context Protocol makes them, without its SDK."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from threading import Event, Thread
from typing import Any

import pytest

from agents.language import server
from agents.language.agent import LanguageAgent
from agents.language.game import GameOptions, GameOver, Phase
from agents.language.server import play
from env_server.toys import SkeletonEnvironment
from glue.engine.local import local
from glue.errors import ConfigError
from glue.plugins.loading import make_agent
from glue.types import Action, Step


class Door(LanguageAgent):
    """A door through which the test calls the tools."""

    how = "call tools"

    def choose(self) -> None:
        self.changed.wait(min(self.game.time_left, 60.0))


class Slow(SkeletonEnvironment):
    """The walk, whose steps wait while `gate` is closed."""

    def __init__(self) -> None:
        super().__init__()
        self.gate = Event()
        self.gate.set()

    def env_step(self, action: Action) -> Step:
        self.gate.wait()
        return super().env_step(action)


@contextmanager
def session(episodes: int, **options: Any) -> Iterator[tuple[Door, Slow, Event]]:
    """Yield an agent that plays in another thread, its environment, and whether the experiment may begin."""
    agent, environment, begin = Door(GameOptions(**options)), Slow(), Event()

    def experiment() -> None:
        with local(agent, environment) as glue:
            begin.wait()
            glue.rl_init()
            for _ in range(episodes):
                glue.rl_episode()
            glue.rl_cleanup()

    thread = Thread(target=experiment)
    thread.start()
    yield agent, environment, begin
    thread.join()


def test_a_game_is_played_by_calls_from_another_thread() -> None:
    with session(episodes=2) as (agent, _, begin):
        begin.set()
        assert "You are @" in play(agent, "look", {}).text
        assert play(agent, "act", {"turn": 1, "actions": ["right*3"]}).data["steps"] == 3
        first = play(agent, "act", {"turn": 2, "actions": ["right*7"]})
        assert first.data["over"]
        assert play(agent, "act", {"turn": 2, "actions": ["right*7"]}) is first
        assert play(agent, "look", {}).data["turn"] == 4
        assert play(agent, "give_up", {"turn": 4}).data["forfeit"]
        with pytest.raises(GameOver):
            play(agent, "look", {})
    assert agent.agent_metrics().items() > {"forfeits": 1.0, "illegal": 0.0}.items()


@pytest.mark.parametrize(
    ("arguments", "says", "illegal"),
    [
        ({}, "turn is a whole number; the current turn is 1", 0),
        ({"turn": True, "actions": ["left"]}, "turn is a whole number", 0),
        ({"turn": "1", "actions": ["left"]}, "turn is a whole number", 0),
        ({"turn": 7, "actions": ["left"]}, "the current turn is 1", 0),
        ({"turn": 1}, "no list of actions was given", 1),
        ({"turn": 1, "actions": "left"}, "no list of actions was given", 1),
        ({"turn": 1, "actions": ["left"], "until": ["x"]}, "until is one of end, reward, change", 1),
        ({"turn": 1, "actions": ["left", "up"]}, "'up' is no legal action; legal are: left, right", 1),
    ],
)
def test_what_is_wrong_with_a_call_is_told_to_the_model(
    arguments: dict[str, Any], says: str, illegal: int
) -> None:
    with session(episodes=1) as (agent, _, begin):
        begin.set()
        play(agent, "look", {})
        answer = play(agent, "act", arguments)
        assert answer.error
        assert says in answer.text
        assert agent.game.counts.illegal == illegal
        play(agent, "act", {"turn": agent.game.turn, "actions": ["left*20"]})


def test_a_call_is_answered_however_long_the_game_takes(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(server, "_PATIENCE", 0.05)
    with session(episodes=1) as (agent, environment, begin):
        waiting = play(agent, "look", {})
        assert "has not begun" in waiting.text
        assert play(agent, "act", {"turn": 0, "actions": ["left"]}).error
        begin.set()
        while agent.game.phase is not Phase.CHOOSING:
            play(agent, "look", {})
        environment.gate.clear()
        call = {"turn": 1, "actions": ["right*2"]}
        assert "Repeat this call" in play(agent, "act", call).text
        assert "Repeat this call" in play(agent, "act", call).text
        environment.gate.set()
        while "Repeat" in (answer := play(agent, "act", call)).text:
            pass
        assert answer.data["steps"] == 2
        play(agent, "act", {"turn": 2, "actions": ["right*20"]})


def test_a_client_that_stays_silent_forfeits_when_time_is_limited() -> None:
    with session(episodes=1, seconds=0.05) as (agent, _, begin):
        begin.set()
    assert agent.game.counts.forfeits == 1


def test_what_the_client_sent_is_recorded_once() -> None:
    with session(episodes=1) as (agent, _, begin):
        begin.set()
        play(agent, "look", {})
        for _ in range(2):
            play(agent, "act", {"turn": 1, "actions": ["right"]})
        play(agent, "give_up", {"turn": 2})
    kept = [each["answer"] for each in agent.game.record()["answers"]]
    assert kept == ['{"turn": 1, "actions": ["right"]}', '{"turn": 2}']


def test_without_the_sdk_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(server, "find_spec", lambda name: None)
    with pytest.raises(ConfigError, match=r"glue-rl\[mcp\]"):
        make_agent("mcp")
