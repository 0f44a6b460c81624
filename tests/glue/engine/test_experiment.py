"""Arguments of an experiment's verbs, in one process and over a hub: mistakes raise where they are made."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest

from glue.engine.experiment import Experiment
from glue.engine.local import local
from glue.errors import LocalProtocolError
from glue.types import Action, Observation
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


def test_numbers_may_be_of_numpy(glue: Experiment) -> None:
    assert glue.rl_init(seed=np.int64(7)) == "a task"  # type: ignore[arg-type]
    assert not glue.rl_episode(np.uint32(2))  # type: ignore[arg-type]
    assert glue.rl_num_steps() == 2
