"""Linear SARSA over tile coding."""

from __future__ import annotations

import pytest

from agents.linear import LinearAgent
from glue import Action, Environment, LocalProtocolError, Observation, PeerFailed, Step, local
from glue.taskspec.spaces import Box, Chars, Discrete, task_spec
from tests.players import returns


class Hill(Environment):
    """A car in a valley, of unbounded speed: each step costs 1 until the car is at the top."""

    def env_init(self) -> str:
        low, high = [-1.2, -float("inf")], [0.6, float("inf")]
        return task_spec(Box(low, high), Discrete(3, start=-1), rewards=(-1, 0))

    def env_start(self) -> Observation:
        self.place, self.speed = -0.5, 0.0
        return self.shown()

    def env_step(self, action: Action) -> Step:
        slope = 0.0025 * (1 - 4.5 * (self.place + 0.5) ** 2)
        self.speed += 0.003 * int(action.ints[0]) - slope * (1 if self.place > -0.5 else -1)
        self.place = max(self.place + self.speed, -1.2)
        return Step(-1.0, self.shown(), self.place >= 0.5)

    def shown(self) -> Observation:
        return Observation(doubles=[self.place, 50 * self.speed])


def played(agent: LinearAgent, episodes: int, data: bytes = b"") -> list[float]:
    with local(agent, Hill()) as glue:
        glue.rl_init(seed=3)
        if data:
            glue.rl_agent_load(data)
        return returns(glue, episodes, 1000)


def test_it_learns_and_what_it_learned_can_be_saved() -> None:
    agent = LinearAgent()
    learning = played(agent, 40)
    assert sum(learning[-10:]) > 2 * sum(learning[:10])
    data = agent.agent_save()
    trained = played(LinearAgent(learning=False, epsilon=0.0), 2, data)
    assert trained[0] == trained[1] > learning[0]
    assert int(agent.agent_message("weights")) > 100
    with pytest.raises(PeerFailed, match="tiles=8"):
        played(LinearAgent(tiles=4), 1, data)


@pytest.mark.parametrize(
    "spec",
    [
        task_spec(Box(0, 1, (17,)), Discrete(2)),
        task_spec(Chars(3), Discrete(2)),
        task_spec(Box(0, 1), Box(0, 1)),
        task_spec(Box(0, 1), Box(0, float("inf"), dtype=int)),
    ],
)
def test_tasks_of_another_shape_are_refused(spec: str) -> None:
    with pytest.raises(LocalProtocolError):
        LinearAgent().agent_init(spec)


@pytest.mark.parametrize("numbers", [[float("nan"), 0.0], [float("inf"), 0.0]])
def test_observed_numbers_that_have_no_cell_are_a_clear_error(numbers: list[float]) -> None:
    agent = LinearAgent()
    agent.agent_init(Hill().env_init())
    with pytest.raises(LocalProtocolError, match="NaN, or infinite in spite of bounds"):
        agent.agent_start(Observation(doubles=numbers))
