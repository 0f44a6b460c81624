"""PufferLib and TorchRL, if installed, play Infinite Mario through Gymnasium, as docs/gymnasium.md shows."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

gymnasium: Any = pytest.importorskip("gymnasium", reason="needs Gymnasium: the extra gym")

pytestmark = pytest.mark.filterwarnings("ignore")

ID = "env_server.gym:glue/InfiniteMario-v0"


def test_pufferlib_plays_what_gymnasium_plays() -> None:
    emulation: Any = pytest.importorskip("pufferlib.emulation", reason="needs PufferLib")
    env, direct = emulation.GymnasiumPufferEnv(gymnasium.make(ID)), gymnasium.make(ID)
    shown, _ = env.reset(seed=1)
    expected, _ = direct.reset(seed=1)
    for step in range(5):
        for name, part in expected.items():
            assert shown.view(env.obs_dtype)[name].tobytes() == part.tobytes()
        action = np.array([2, step % 2, 1])
        shown, *outcome = env.step(action)
        expected, *direct_outcome = direct.step(action)
        assert outcome == direct_outcome


def test_torchrl_plays_what_gymnasium_plays() -> None:
    torchrl_gym: Any = pytest.importorskip("torchrl.envs.libs.gym", reason="needs TorchRL")
    from torch import tensor
    from torch.nn.functional import one_hot
    from torchrl.envs.utils import step_mdp

    direct = gymnasium.make(ID, action="discrete")
    env = torchrl_gym.GymWrapper(gymnasium.make(ID, action="discrete"))
    data = env.reset()
    shown, _ = direct.reset()
    for _ in range(5):
        for name, part in shown.items():
            assert data[name].numpy().tobytes() == part.tobytes()
        data = env.step(data.set("action", one_hot(tensor(9), 12)))
        shown, reward, *_ = direct.step(9)
        assert data["next", "reward"].item() == np.float32(reward)
        data = step_mdp(data)
