"""sb3-contrib's MaskablePPO, unmodified, learns from masks, and its policies play as agents."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from glue import local, make, make_agent
from glue.errors import ConfigError
from glue.roles import capabilities
from tests.hubs import hub_with

contrib: Any = pytest.importorskip("sb3_contrib", reason="needs sb3-contrib: the extra sb3")
# Networks as small as these gain nothing from more threads, which wait for each other on a busy machine.
pytest.importorskip("torch").set_num_threads(1)
import gymnasium  # noqa: E402

import glue.gym  # noqa: E402
import tests.glue.gym.environments  # noqa: E402, F401
from glue.gym.sb3 import SB3VecEnv  # noqa: E402
from glue.gym.vectors import AutoresetMode  # noqa: E402

NAME = "gymnasium:tests/Masked-v0"
SMALL: dict[str, Any] = {
    "n_steps": 64,
    "batch_size": 64,
    "learning_rate": 3e-3,
    "n_epochs": 4,
    "seed": 1,
    "device": "cpu",
}
pytestmark = pytest.mark.filterwarnings("ignore")


class Legal(gymnasium.Wrapper[Any, Any, Any, Any]):  # type: ignore[misc]
    """Fails a test that takes an illegal action."""

    def step(self, action: Any) -> Any:
        legal = self.env.get_wrapper_attr("action_masks")()
        assert legal[action[0]]
        assert legal[3 + action[1]]
        return self.env.step(action)


def test_it_learns_an_action_of_unequal_parts_and_plays_as_an_agent(tmp_path: Path) -> None:
    env = Legal(glue.gym.wrap(make(NAME, action_mask=True)))
    model = contrib.MaskablePPO("MlpPolicy", env, **SMALL)
    model.learn(1_500)
    model.save(tmp_path / "model")
    env.close()
    agent = make_agent("sb3", policy=str(tmp_path / "model.zip"), algorithm="MaskablePPO")
    assert "mask" in capabilities(agent)
    returns = []
    for masks in (True, False):
        with local(agent, make(NAME, action_mask=masks)) as experiment:
            experiment.rl_init(1)
            experiment.rl_episode()
            returns.append(experiment.rl_return())
    assert returns[0] == 8.0, "at random among the legal actions it is 6"
    with pytest.raises(ConfigError, match="is not a policy of PPO"):
        make_agent("sb3", policy=str(tmp_path / "model.zip"))


def test_many_sessions_give_their_masks_to_it() -> None:
    sessions = ["one", "two"]
    with hub_with({name: make(NAME, action_mask=True) for name in sessions}) as hub:
        envs = SB3VecEnv(glue.gym.connect_vec(hub, sessions, autoreset_mode=AutoresetMode.SAME_STEP))
        model = contrib.MaskablePPO("MlpPolicy", envs, **SMALL)
        model.learn(256)
        envs.reset()
        for step in range(9):
            masks = np.stack(envs.env_method("action_masks"))
            assert masks.shape == (2, 5)
            assert masks[:, 3 + step % 4 % 2].all()
            envs.step(np.array([[step % 4 % 3, step % 4 % 2]] * 2))
        envs.close()


def test_games_without_masks_have_no_such_method() -> None:
    mode = {"vectorization_mode": "sync", "vector_kwargs": {"autoreset_mode": "SameStep"}}
    envs = SB3VecEnv(gymnasium.make_vec("FrozenLake-v1", num_envs=2, **mode))
    envs.reset()
    assert not envs.has_attr("action_masks")
    assert envs.has_attr("num_envs")
    envs.close()
