"""RL-Glue and Gymnasium, each as the other: docs/gymnasium.md.

    env = glue.gym.wrap(glue.make("mines"))            # an RL-Glue environment as a gymnasium.Env
    env = glue.gym.connect("tcp://127.0.0.1:4097")     # the same, behind a hub, in any language
    envs = glue.gym.connect_vec(hub, ["one", "two"])   # many sessions

The names below are imported when they are first used, so that a missing Gymnasium is reported in one line.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any, Final

from glue.errors import ConfigError

if TYPE_CHECKING:
    from glue.gym.client import GlueEnv, connect, connect_vec, wrap
    from glue.gym.served import GymnasiumEnvironment, environment_class, game_class

__all__ = [
    "GlueEnv",
    "GymnasiumEnvironment",
    "connect",
    "connect_vec",
    "environment_class",
    "game_class",
    "wrap",
]

_HOMES: Final = {
    "glue.gym.client": ("GlueEnv", "connect", "connect_vec", "wrap"),
    "glue.gym.served": ("GymnasiumEnvironment", "environment_class", "game_class"),
}


def __getattr__(name: str) -> Any:
    for module, names in _HOMES.items():
        if name in names:
            try:
                return getattr(import_module(module), name)
            except ModuleNotFoundError as error:
                if error.name != "gymnasium":
                    raise
                raise ConfigError("glue.gym needs Gymnasium: pip install 'glue-rl[gym]'") from None
    raise AttributeError(f"module 'glue.gym' has no attribute {name!r}")
