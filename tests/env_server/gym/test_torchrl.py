"""TorchRL, if installed, plays Infinite Mario through Gymnasium."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

gymnasium: Any = pytest.importorskip("gymnasium", reason="needs Gymnasium: the extra gym")
torchrl_gym: Any = pytest.importorskip("torchrl.envs.libs.gym", reason="needs TorchRL")

ID = "env_server.gym:glue/InfiniteMario-v0"


@pytest.mark.filterwarnings("ignore")
def test_an_episode_is_what_gymnasium_plays() -> None:
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
