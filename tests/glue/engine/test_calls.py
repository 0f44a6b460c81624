"""Calls on players: an action or observation of the wrong size is blamed on its sender."""

from __future__ import annotations

from typing import Any

import pytest

from agents.baselines import RandomAgent
from agents.tabular import SarsaAgent
from env_server.toys import MinesEnvironment
from glue.engine.calls import agent_calls, environment_calls
from glue.engine.local import local
from glue.errors import PeerFailed
from glue.types import Action, Observation, Step
from glue.wire.messages import Kind

SPEC = MinesEnvironment().env_init()


def answering(player: type[Any], method: str, answer: object) -> Any:
    """Return a player whose method always returns one answer."""
    return type("Wrong", (player,), {method: lambda *_: answer})()


TALK = Action([1, 2], [0.5], b"ab")


@pytest.mark.parametrize(
    ("player", "method", "answer", "words"),
    [
        (RandomAgent, "agent_start", Action([0, 1]), "1 int, .* returned 2 ints$"),
        (RandomAgent, "agent_step", Action([0, 1]), "1 int, .* returned 2 ints$"),
        (RandomAgent, "agent_step", TALK, "1 int, .* returned 2 ints, 1 double, 2 chars$"),
        (MinesEnvironment, "env_start", Observation([], [0.5]), "1 int, .* returned 1 double$"),
        (MinesEnvironment, "env_step", Step(0.0, Observation([], [0.5]), False), "1 int, .* 1 double$"),
    ],
)
def test_an_answer_of_the_wrong_size_is_blamed_on_its_sender(
    player: type[Any], method: str, answer: object, words: str
) -> None:
    wrong = answering(player, method, answer)
    agent = wrong if player is RandomAgent else RandomAgent()
    environment = wrong if player is MinesEnvironment else MinesEnvironment()
    with local(agent, environment) as glue:
        glue.rl_init(seed=1)
        with pytest.raises(PeerFailed, match=f"{method} of Wrong must return {words}"):
            glue.rl_start(), glue.rl_step()


def test_a_save_that_is_not_bytes_is_a_wrong_answer() -> None:
    class Texting(SarsaAgent):
        def agent_save(self) -> bytes:
            return "a save"  # type: ignore[return-value]

    with pytest.raises(PeerFailed, match="agent_save of Texting must return bytes; it returned str 'a save'"):
        agent_calls(Texting())[Kind.AGENT_SAVE]((), None)


def test_player_that_raises_for_what_it_was_given_is_not_blamed() -> None:
    """The wrong sender is one that nothing checks, such as a program in another language."""
    environment = environment_calls(MinesEnvironment())
    environment[Kind.ENV_INIT]((), None)
    environment[Kind.ENV_START]((), None)
    with pytest.raises(
        PeerFailed, match=r"the agent sent nothing, and the task spec says 1 int \(SimulatorError"
    ):
        environment[Kind.ENV_STEP]((), Action())

    class Strict(RandomAgent):
        def agent_start(self, observation: Observation) -> Action:
            return Action(ints=[observation.ints[0]])

    agent = agent_calls(Strict())
    agent[Kind.AGENT_INIT]((), SPEC)
    with pytest.raises(PeerFailed, match="the environment sent 1 double, and the task spec says 1 int"):
        agent[Kind.AGENT_START]((), Observation(doubles=[1.0]))


@pytest.mark.parametrize("task_spec", ["a task", "VERSION private", "2:e:1_[i]_[0,9]"])
def test_what_the_task_spec_does_not_state_is_not_checked(task_spec: str) -> None:
    class Vague(MinesEnvironment):
        def env_init(self) -> str:
            super().env_init()
            return task_spec

    environment = environment_calls(Vague())
    environment[Kind.ENV_INIT]((), None)
    assert environment[Kind.ENV_START]((), None)
