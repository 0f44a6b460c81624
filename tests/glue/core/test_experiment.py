"""What an experiment may pass, in one process and over a hub: mistakes are reported where they are made."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from threading import Thread
from typing import Any

import numpy as np
import pytest

from glue.client.experiment import connect
from glue.client.players import serve_agent, serve_environment
from glue.core.config import HubConfig
from glue.core.experiment import Experiment
from glue.core.local import local
from glue.errors import LocalProtocolError
from glue.hub.server import Hub
from glue.types import Action, Observation
from tests.players import ScriptedAgent, ScriptedEnvironment


def quiet(line: str) -> None:
    """Say nothing."""


@pytest.fixture(params=["local", "hub"])
def glue(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Experiment]:
    if request.param == "local":
        yield local(ScriptedAgent(), ScriptedEnvironment())
        return
    url = f"ipc://{tmp_path}/hub"
    players = (
        Thread(target=serve_agent, args=(ScriptedAgent(), url), kwargs={"log": quiet}),
        Thread(target=serve_environment, args=(ScriptedEnvironment(), url), kwargs={"log": quiet}),
    )
    with ExitStack() as stack:
        for player in players:
            stack.callback(player.join)
        stack.enter_context(Hub(HubConfig(bind=(url,))).in_background())
        for player in players:
            player.start()
        yield stack.enter_context(connect(url, log=quiet))


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
