"""Calls on players: an action or observation of the wrong size is blamed on its sender."""

from __future__ import annotations

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


class Greedy(RandomAgent):
    """Returns one int too many, from its second action on."""

    def agent_step(self, reward: float, observation: Observation) -> Action:
        return Action(ints=[0, 1])


class Blurred(MinesEnvironment):
    """Shows a double where its task spec has an int, after the first observation."""

    def env_step(self, action: Action) -> Step:
        return Step(0.0, Observation(doubles=[0.5]), False)


def test_agent_whose_action_has_too_many_ints_is_blamed() -> None:
    with local(Greedy(), MinesEnvironment()) as glue:
        glue.rl_init(seed=1)
        glue.rl_start()
        with pytest.raises(PeerFailed, match=r"agent_step of Greedy must return 1 int.* returned 2 ints"):
            glue.rl_step()


def test_environment_whose_observation_is_not_as_it_said_is_blamed() -> None:
    with local(RandomAgent(), Blurred()) as glue:
        glue.rl_init(seed=1)
        glue.rl_start()
        with pytest.raises(PeerFailed, match=r"env_step of Blurred must return 1 int.* returned 1 double"):
            glue.rl_step()


def test_what_was_returned_and_expected_is_counted_by_its_kind() -> None:
    class Talking(RandomAgent):
        def agent_step(self, reward: float, observation: Observation) -> Action:
            return Action([1, 2], [0.5], b"ab")

    with local(Talking(), MinesEnvironment()) as glue:
        glue.rl_init(seed=1)
        glue.rl_start()
        with pytest.raises(PeerFailed, match=r"must return 1 int, .* returned 2 ints, 1 double, 2 chars$"):
            glue.rl_step()


def test_first_answers_are_checked_as_the_later_ones_are() -> None:
    class Early(MinesEnvironment):
        def env_start(self) -> Observation:
            return Observation(doubles=[0.5])

    with local(RandomAgent(), Early()) as glue:
        glue.rl_init(seed=1)
        with pytest.raises(PeerFailed, match=r"env_start of Early must return 1 int.* returned 1 double"):
            glue.rl_start()

    class Hasty(RandomAgent):
        def agent_start(self, observation: Observation) -> Action:
            return Action(ints=[0, 1])

    with local(Hasty(), MinesEnvironment()) as glue:
        glue.rl_init(seed=1)
        with pytest.raises(PeerFailed, match=r"agent_start of Hasty must return 1 int.* returned 2 ints"):
            glue.rl_start()


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
