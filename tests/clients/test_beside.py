"""Masks and extras in every language, at a hub: who sends and who reads them; no agent sees extras."""

from __future__ import annotations

from pathlib import Path

import pytest

from agents.baselines import SkeletonAgent
from glue import PeerFailed, connect
from glue.engine.local import local
from glue.roles import Environment
from glue.types import Action, Observation, Step
from tests.clients.languages import LANGUAGES, OWN, Language, own_program
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


def test_mask_without_a_legal_value_is_an_error_where_it_is_made(
    language: Language, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    task_spec = Doors().env_init().replace("(0 2) (5 11)", "(0 1) (4 6)")
    nowhere = Path(__file__).with_name("nowhere").with_suffix(Path(OWN[language.name][0]).suffix)
    start = own_program(language, nowhere.read_text("utf-8").replace("TASK_SPEC", task_spec), tmp_path)

    # The agent reads no masks: only the environment can have noticed.
    with hub_with(SkeletonAgent()) as url, program(start, url), connect(url) as glue:
        glue.rl_init()
        glue.rl_start()
        with pytest.raises(PeerFailed, match=r"step returned .* mask .*: no value of int 1 is legal"):
            glue.rl_step()
