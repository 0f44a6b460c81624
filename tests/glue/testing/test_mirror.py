"""The mirror does what docs/clients.md says; the page's examples are run here."""

from __future__ import annotations

import struct

from glue.conform.hub.mirror import MirrorAgent, MirrorEnvironment, play, result
from glue.engine.local import local
from glue.types import Action, Observation, Step


def test_the_action_of_the_page() -> None:
    agent = MirrorAgent()
    agent.agent_init("")
    agent.agent_start(Observation([1]))
    action = agent.agent_step(-1.0, Observation([3, -5], [0.5], b"ab"))
    assert action == Action([-5, 3, 2], [0.5, -2.0, -1.0], b"ba")
    assert agent.agent_step(1.0, Observation()) == Action()
    assert agent.agent_save() == b"3 0"


def test_the_environment_rewards_and_ends_as_its_action_says() -> None:
    environment = MirrorEnvironment()
    environment.env_init()
    assert environment.env_start() == Observation([1])
    assert environment.env_step(Action([7], [-0.0, 2.0], b"a!"))[:3] == (
        0.0,
        Observation([7, 2], [2.0, -0.0, 7.0], b"!a"),
        True,
    )
    reward = environment.env_step(Action(doubles=[-0.0]))[0]
    assert struct.pack("<d", reward) == struct.pack("<d", -0.0)
    assert environment.env_step(Action())[:3] == (0.0, Observation(), False)


class Ordering(MirrorEnvironment):
    """An environment that gives one order after another, and keeps the results that the experiment shows."""

    def __init__(self, *orders: Observation) -> None:
        super().__init__()
        self.orders = list(orders)
        self.shown: list[Action] = []

    def env_step(self, action: Action) -> Step:
        if not self.orders:
            return Step(1.0, Observation([20]), True)
        self.shown.append(action)
        return Step(0.25, self.orders.pop(0), False)


def test_the_experiment_shows_what_came_of_its_orders() -> None:
    environment = Ordering(
        Observation(chars=b"RL_INIT 7"),
        Observation(chars=b"RL_START"),
        Observation(chars="RL_AGENT_MESSAGE größer".encode()),
        Observation([4], [0.5], b"RL_AGENT_STEP x"),
        Observation(chars=b"RL_NUM_STEPS"),
        Observation(chars=b"RL_AGENT_MESSAGE fail"),
        Observation(chars=b"notices"),
        Observation(chars=b"end"),
    )
    with local(MirrorAgent(), environment) as glue:
        play(glue, ["joined agent mirror", "lost agent mirror"])
    spec = "a mirror, größer than it is".encode()
    assert environment.shown[:5] == [
        Action(chars=b"ready"),
        result(chars=spec),
        result([1, 1, 1], [1.0, 0.0]),
        result(chars="größer".encode()),
        result([4, 2], [0.5, 4.0, 0.25], b"x"),
    ]
    # Each order is an RL_ENV_STEP itself: three since RL_START, which counts as one.
    assert environment.shown[5] == result(chars=b"4")
    assert environment.shown[6].chars.startswith(b"ERROR peer-failed ")
    assert environment.shown[7] == result(chars=b"joined agent mirror\nlost agent mirror")
