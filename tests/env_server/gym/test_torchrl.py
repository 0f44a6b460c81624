"""TorchRL plays Infinite Mario through Gymnasium. A stage of .ci/run."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

gymnasium: Any = pytest.importorskip("gymnasium", reason="needs Gymnasium: the extra gym")
torchrl_gym: Any = pytest.importorskip("torchrl.envs.libs.gym", reason="needs TorchRL")

ID = "env_server.gym:glue/InfiniteMario-v0"


@pytest.mark.filterwarnings("ignore")
def test_a_rollout_is_what_gymnasium_plays() -> None:
    env = torchrl_gym.GymWrapper(gymnasium.make(ID, action="discrete"))
    rollout = env.rollout(5, policy=lambda data: data.set("action", one_hot(9)))
    direct = gymnasium.make(ID, action="discrete")
    shown, _ = direct.reset()
    for step in range(5):
        assert rollout["tiles"][step].numpy().tobytes() == shown["tiles"].tobytes()
        shown, reward, *_ = direct.step(9)
        assert rollout["next", "reward"][step].item() == np.float32(reward)


def one_hot(action: int) -> Any:
    import torch

    return torch.nn.functional.one_hot(torch.tensor(action), 12)
