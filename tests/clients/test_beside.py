"""Masks and extras in every language, at a hub: who sends and who reads them; no agent sees extras."""

from __future__ import annotations

import pytest

from glue import connect
from glue.conform.clients.mirror import MirrorAgent, MirrorEnvironment
from glue.engine.local import local
from glue.roles import Environment
from glue.types import Action, Observation, Step
from tests.clients.languages import LANGUAGES, Language
from tests.clients.random_agent import RandomAgent
from tests.clients.table import program
from tests.hubs import hub_with

STEPS = 30
SEED = 7


@pytest.fixture(params=LANGUAGES, ids=lambda language: language.name)
def language(request: pytest.FixtureRequest) -> Language:
    asked: Language = request.param
    asked.ready()
    return asked


class Doors(Environment):
    """Two ints, from 0 to 2 and from 5 to 11; which doors are open depends on the number of the step.

    An action through a closed door is an error. Every third observation has no mask.
    """

    env_masks = True
    env_extras = True

    def __init__(self) -> None:
        self.steps = 0

    def env_init(self) -> str:
        self.steps = 0
        return (
            "VERSION RL-Glue-3.0 PROBLEMTYPE episodic DISCOUNTFACTOR 1.0 OBSERVATIONS INTS (0 1000) "
            "ACTIONS INTS (0 2) (5 11) REWARDS (0 1) EXTRA masks"
        )

    def env_start(self) -> Observation:
        return self._seen()

    def env_step(self, action: Action) -> Step:
        first, second = action.ints.tolist()
        assert self._open(first)
        assert self._open(second - 2)
        self.steps += 1
        return Step(0.5, self._seen(), False)

    def _open(self, door: int) -> bool:
        return self.steps % 3 == 2 or (door + self.steps) % 3 != 0

    def _seen(self) -> Observation:
        mask = None if self.steps % 3 == 2 else [self._open(door) for door in range(10)]
        return Observation([self.steps], mask=mask, extras={"doors.steps": self.steps})


def test_random_agent_takes_open_doors_only(language: Language) -> None:
    ours = local(RandomAgent(), Doors())
    ours.rl_init(SEED)
    expected = [ours.rl_start().action, *(ours.rl_step().action for _ in range(STEPS))]

    with hub_with(Doors()) as url, program(language.programs["random"], url), connect(url) as glue:
        glue.rl_init(SEED)
        observation, action = glue.rl_start()
        steps = [glue.rl_step() for _ in range(STEPS)]

    assert [action, *(step.action for step in steps)] == expected
    seen = [observation, *(step.observation for step in steps)]
    assert [one.extras for one in seen] == [{"doors.steps": number} for number in range(STEPS + 1)]


class Fixed(Environment):
    """Always the same observation, with everything beside it; its task spec promises nothing."""

    env_masks = True
    env_extras = True

    seen = Observation(
        [3, -5],
        [0.5],
        b"ab",
        mask=[True, False, False, True, True, False, False, False, True],
        extras={
            "z.int": -(2**63),
            "float": 0.25,
            "text": "größer",
            "bytes": b"\0\xff",
            "ints": [1, -300, 2**62 + 1],
            "floats": [0.5, -1.5],
            "none": [],
        },
    )

    def env_init(self) -> str:
        return "no task spec"

    def env_start(self) -> Observation:
        return self.seen

    def env_step(self, action: Action) -> Step:
        return Step(1.0, self.seen, False)


def test_agent_sees_the_mask_and_no_extras(language: Language) -> None:
    agent = MirrorAgent()
    expected = [agent.agent_start(Fixed.seen.without()), agent.agent_step(1.0, Fixed.seen.without())]

    with (
        hub_with(Fixed()) as url,
        program((*language.programs["mirror"], "agent"), url),
        connect(url) as glue,
    ):
        glue.rl_init()
        observation, action = glue.rl_start()
        step = glue.rl_step()

    assert observation == step.observation == Fixed.seen
    assert [action, step.action] == expected


@pytest.mark.parametrize("ints", [[1, 0, -2, 4, 0, 0, 0, 0, 9], [], [1] * 8])
def test_environment_sends_both(language: Language, ints: list[int]) -> None:
    action = Action(ints, [0.5, -1.5], b"\0\xff&")
    ours = MirrorEnvironment()
    ours.env_init()
    expected = ours.env_step(action).observation

    mirror = (*language.programs["mirror"], "environment")
    with hub_with(MirrorAgent()) as url, program(mirror, url), connect(url) as glue:
        glue.rl_init()
        observation = glue.rl_env_step(action).observation

    assert (observation.packed_mask, observation.extras) == (expected.packed_mask, expected.extras)
    assert observation.without(mask=True) == expected.without(mask=True)
