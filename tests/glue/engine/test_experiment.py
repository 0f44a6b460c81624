"""Arguments of an experiment's verbs, in one process and over a hub: mistakes raise where they are made."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest

from glue.engine.experiment import Experiment
from glue.engine.local import local
from glue.errors import LocalProtocolError
from glue.types import Action, Observation, Step
from tests.hubs import over_the_hub
from tests.players import ScriptedAgent, ScriptedEnvironment


@pytest.fixture(params=[local, over_the_hub], ids=["local", "hub"])
def glue(request: pytest.FixtureRequest) -> Iterator[Experiment]:
    with request.param(ScriptedAgent(), ScriptedEnvironment()) as glue:
        yield glue


MISTAKES: list[tuple[Callable[[Any], object], str]] = [
    (lambda glue: glue.rl_episode(-1), r"a step limit must be from 0 to 2\^32 - 1, not -1"),
    (lambda glue: glue.rl_episode(2**32), r"a step limit must be from 0 to 2\^32 - 1, not 4294967296"),
    (lambda glue: glue.rl_episode(1e3), r"a step limit must be a whole number, not 1000\.0"),
    (lambda glue: glue.rl_init(-1), r"a seed must be from 0 to 2\^63 - 1, not -1"),
    (lambda glue: glue.rl_init(2**63), r"a seed must be from 0 to 2\^63 - 1"),
    (lambda glue: glue.rl_init("lucky"), "a seed must be a whole number, not 'lucky'"),
    (lambda glue: glue.rl_agent_message(5), "type str, not 5"),
    (lambda glue: glue.rl_env_message(None), "type str, not None"),
    (lambda glue: glue.rl_env_step(Observation()), r"type Action, not Observation\(\)"),
    (lambda glue: glue.rl_agent_start(Action()), r"type Observation, not Action\(\)"),
    (lambda glue: glue.rl_agent_step(0.0, 7), "type Observation, not 7"),
    (lambda glue: glue.rl_agent_load("text"), "type bytes, not 'text'"),
    (lambda glue: glue.rl_env_load(None), "type bytes, not None"),
]


def test_a_mistake_is_answered_at_once_and_the_session_goes_on(glue: Experiment) -> None:
    glue.rl_init()
    for mistake, complaint in MISTAKES:
        with pytest.raises(LocalProtocolError, match=complaint):
            mistake(glue)
    assert not glue.rl_episode(3)
    assert glue.rl_num_steps() == 3


def test_largest_seed_and_limit_are_accepted(glue: Experiment) -> None:
    assert glue.rl_init(2**63 - 1) == "a task"
    assert glue.rl_episode(2**32 - 1)


class Keeping(ScriptedAgent):
    saved = b"the agent's"

    def agent_save(self) -> bytes:
        return self.saved

    def agent_load(self, data: bytes) -> None:
        self.saved = data


class KeepingEnvironment(ScriptedEnvironment):
    saved = b"the environment's"

    def env_save(self) -> bytes:
        return self.saved

    def env_load(self, data: bytes) -> None:
        self.saved = data

    def env_step(self, action: Action) -> Step:  # type: ignore[override]
        reward, observation, terminal = super().env_step(action)
        return Step(reward, observation, terminal, truncated=terminal)


@pytest.mark.parametrize("make", [local, over_the_hub])
def test_half_steps_and_saves_reach_the_players(make: Callable[..., Any]) -> None:
    with make(Keeping(), KeepingEnvironment(length=2)) as glue:
        glue.rl_init()
        assert glue.rl_env_start() == Observation([0])
        assert glue.rl_agent_start(Observation([0])) == Action([100])
        assert glue.rl_env_step(Action([100])) == Step(1.0, Observation([1]), False, False)
        assert glue.rl_agent_step(1.0, Observation([1])) == Action([101])
        assert glue.rl_env_step(Action([101])) == Step(1.0, Observation([2]), True, True)
        assert (glue.rl_agent_save(), glue.rl_env_save()) == (b"the agent's", b"the environment's")
        glue.rl_agent_load(b"another agent's")
        glue.rl_env_load(b"another environment's")
        assert (glue.rl_agent_save(), glue.rl_env_save()) == (b"another agent's", b"another environment's")


def test_numbers_may_be_of_numpy(glue: Experiment) -> None:
    assert glue.rl_init(seed=np.int64(7)) == "a task"  # type: ignore[arg-type]
    assert not glue.rl_episode(np.uint32(2))  # type: ignore[arg-type]
    assert glue.rl_num_steps() == 2
