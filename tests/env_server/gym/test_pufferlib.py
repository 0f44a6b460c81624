"""PufferLib, if installed, plays Infinite Mario through Gymnasium, as docs/gymnasium.md shows."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

gymnasium: Any = pytest.importorskip("gymnasium", reason="needs Gymnasium: the extra gym")
emulation: Any = pytest.importorskip("pufferlib.emulation", reason="needs PufferLib")

ID = "env_server.gym:glue/InfiniteMario-v0"


@pytest.mark.filterwarnings("ignore")
def test_an_emulated_episode_is_what_gymnasium_plays() -> None:
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
