"""Calls of tools as a client of the Model Context Protocol makes them, without its SDK."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from queue import SimpleQueue
from threading import Event, Thread
from typing import Any

import pytest

from agents.language import server
from agents.language.game import GameOptions, GameOver, LanguageAgent, Phase
from agents.language.server import MCPAgent, play
from env_server.toys import SkeletonEnvironment
from glue import Action, ConfigError, Environment, Step, local, make_agent


class Door(LanguageAgent):
    """A door through which the test calls the tools."""

    how = "call tools"

    def choose(self) -> None:
        self.changed.wait(min(self.game.time_left, 60.0))


class Slow(SkeletonEnvironment):
    """The walk, whose steps wait while `gate` is closed."""

    gate = Event()

    def env_step(self, action: Action) -> Step:
        self.gate.wait()
        return super().env_step(action)


@contextmanager
def session(
    agent: LanguageAgent, environment: Environment | None = None, episodes: int = 1
) -> Iterator[None]:
    """Run an experiment in a thread."""

    def experiment() -> None:
        with local(agent, environment or SkeletonEnvironment()) as glue:
            glue.rl_init()
            for _ in range(episodes):
                glue.rl_episode(30)
            glue.rl_cleanup()

    thread = Thread(target=experiment)
    thread.start()
    yield
    thread.join()


def test_a_game_is_played_by_calls_from_another_thread() -> None:
    agent = Door(GameOptions())
    with session(agent, episodes=2):
        assert "You are @" in play(agent, "look", {}).text
        call = {"turn": 1, "actions": ["right*10"]}
        first = play(agent, "act", call)
        assert first.data["over"]
        assert play(agent, "act", call) is first
        assert play(agent, "look", {}).data["turn"] == 3
        assert play(agent, "give_up", {"turn": 3}).data["forfeit"]
    agent.game.close()
    with pytest.raises(GameOver):
        play(agent, "look", {})
    assert agent.agent_metrics().items() > {"forfeits": 1.0, "illegal": 0.0, "choices": 1.0}.items()
    assert agent.game.record()["answers"] == [{"turn": 3, "answer": '{"turn": 3}'}]


@pytest.mark.parametrize(
    ("arguments", "says", "illegal"),
    [
        ({}, "turn is a whole number; the current turn is 1", 0),
        ({"turn": "1", "actions": ["left"]}, "turn is a whole number", 0),
        ({"turn": 1}, "no list of actions was given", 1),
        ({"turn": 1, "actions": "left"}, "no list of actions was given", 1),
        ({"turn": 1, "actions": ["left"], "until": ["x"]}, "until is one of end, reward, change", 1),
        ({"turn": 1, "actions": ["left", "up"]}, "'up' is no legal action; legal are: left, right", 1),
    ],
)
def test_what_is_wrong_with_a_call_is_told_to_the_model(
    arguments: dict[str, Any], says: str, illegal: int
) -> None:
    agent = Door(GameOptions())
    agent.game.task(SkeletonEnvironment().env_init())
    agent.game.start(SkeletonEnvironment().env_start())
    answer = play(agent, "act", arguments)
    assert answer.error
    assert says in answer.text
    assert agent.game.counts.illegal == illegal


def test_a_call_is_answered_however_long_the_game_takes(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(server, "_PATIENCE", 0.05)
    agent, environment = Door(GameOptions()), Slow()
    assert "has not begun" in play(agent, "look", {}).text
    assert play(agent, "act", {"turn": 0, "actions": ["left"]}).error
    with session(agent, environment):
        while agent.game.phase is not Phase.CHOOSING:
            play(agent, "look", {})
        call = {"turn": 1, "actions": ["right*10"]}
        for _ in range(2):
            assert "still being played" in play(agent, "act", call).text
        assert "still being played" in play(agent, "act", {"turn": 2, "actions": ["left"]}).text
        environment.gate.set()
        while "Repeat this call" in (answer := play(agent, "act", call)).text:
            pass
    assert answer.data["steps"] == 10


@pytest.fixture
def over_stdio(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let agents be those of a process which a client has started, but whose calls the test makes."""
    monkeypatch.setattr(server, "_NEWEST", {})
    monkeypatch.setattr(server, "_PATIENCE", 0.05)
    monkeypatch.setattr(server, "find_spec", lambda name: True)
    monkeypatch.setattr(server, "_has_client", lambda: True)
    monkeypatch.setattr(MCPAgent, "_serve_stdio", lambda self: None)


@pytest.mark.usefixtures("over_stdio")
def test_agents_in_turn_are_played_by_one_server(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each trial has an agent of its own, and the client of the first plays all of them."""
    first = agent = MCPAgent()
    for turn in (1, 3):
        with session(agent):
            while first.game.phase is not Phase.CHOOSING:
                play(first, "look", {})
            assert play(first, "give_up", {"turn": turn}).data["episode"] == 1
        assert play(first, "look", {}).data["over"]  # and no error: the session may not be the last one
        agent = MCPAgent()
        assert "has not begun" in play(first, "look", {}).text
    with pytest.raises(ConfigError, match="one server serves one session"):
        first.agent_init(SkeletonEnvironment().env_init())

    def interrupted(seconds: float | None) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(first._thread, "join", interrupted)
    first._leave()
    with pytest.raises(GameOver):
        play(first, "look", {})


@pytest.mark.usefixtures("over_stdio")
def test_an_agent_whose_game_another_one_takes_over_does_not_play_on() -> None:
    """It fails while it waits for its client and in every later call, and leaves the other's game alone."""
    agent, seen = MCPAgent(), SkeletonEnvironment().env_start()
    agent.agent_init(SkeletonEnvironment().env_init())
    ended: SimpleQueue[object] = SimpleQueue()

    def start() -> None:
        try:
            ended.put(agent.agent_start(seen))
        except ConfigError as error:
            ended.put(str(error))

    Thread(target=start, daemon=True).start()
    while agent.game.phase is not Phase.CHOOSING:
        play(agent, "look", {})
    newest = MCPAgent()
    assert "one server serves one session" in str(ended.get(timeout=60))
    newest.agent_init(SkeletonEnvironment().env_init())
    before = newest.game.view()
    for late in (
        partial(agent.agent_step, -1.0, seen),
        partial(agent.agent_end, 1.0),
        agent.agent_cleanup,
        agent.agent_metrics,
    ):
        with pytest.raises(ConfigError, match="one server serves one session"):
            late()
    assert newest.game.view() == before


def test_an_experiment_has_no_client_at_its_standard_input(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(server, "_NEWEST", {})
    monkeypatch.setattr(server, "find_spec", lambda name: True)
    nothing = os.stat(os.devnull)
    monkeypatch.setattr("os.fstat", lambda descriptor: nothing)
    with pytest.raises(ConfigError, match="standard input does not come from a client: give mcp a port"):
        make_agent("mcp")


@pytest.mark.parametrize("installed", [[], ["mcp"]])
def test_without_version_2_of_the_sdk_the_extra_is_named(
    monkeypatch: pytest.MonkeyPatch, installed: list[str]
) -> None:
    monkeypatch.setattr(server, "find_spec", lambda name: name in installed or None)
    with pytest.raises(ConfigError, match=r"glue-rl\[mcp\]"):
        make_agent("mcp")
