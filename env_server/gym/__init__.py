"""Infinite Mario as a Gymnasium environment, single and vectorized.

    import gymnasium

    env = gymnasium.make("env_server.gym:glue/InfiniteMario-v0", level_difficulty=1)
    envs = gymnasium.make_vec("env_server.gym:glue/InfiniteMario-v0", num_envs=64, levels="train-200")

docs/gymnasium.md is the user guide.
"""

from __future__ import annotations

from typing import Final

try:
    import gymnasium
except ImportError:
    raise ImportError("env_server.gym needs Gymnasium: pip install 'glue-rl[gym]'") from None

from env_server.gym.single import InfiniteMarioEnv
from env_server.gym.vector import InfiniteMarioVectorEnv

__all__ = ["ENVIRONMENT_ID", "InfiniteMarioEnv", "InfiniteMarioVectorEnv"]

ENVIRONMENT_ID: Final = "glue/InfiniteMario-v0"

gymnasium.register(
    id=ENVIRONMENT_ID,
    entry_point="env_server.gym.single:InfiniteMarioEnv",
    vector_entry_point="env_server.gym.vector:InfiniteMarioVectorEnv",
)
