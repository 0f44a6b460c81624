"""An agent that begins every run with the state learned in another."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

from glue.errors import ConfigError
from glue.files import read_regular
from glue.roles import Agent, SaveableAgent, completed, offers

_MAX_SIZE: Final = 2**30
"""Bytes of the largest file that is read."""


class Trained:
    """`agent`, with `learned` loaded after every init; otherwise unchanged.

    Args:
        agent: an agent with the capability `save`.
        learned: the result of `agent_save` of the same class.
    """

    def __init__(self, agent: Any, learned: bytes) -> None:
        self.__wrapped__: Any = completed(agent, Agent)
        self._learned = learned

    def __getattr__(self, name: str) -> Any:
        return getattr(self.__wrapped__, name)

    def agent_init(self, task_spec: str) -> None:
        self.__wrapped__.agent_init(task_spec)
        self.__wrapped__.agent_load(self._learned)


def load_trained(agent: Any, path: Path) -> Trained:
    """Return `agent` with the state in the file at `path`, as `glue-results agent` writes it.

    Raises:
        ConfigError: the agent cannot load, or the file cannot be read.
    """
    if not offers(agent, SaveableAgent):
        raise ConfigError(f"{type(agent).__name__} cannot load what was learned: it has no agent_load")
    try:
        return Trained(agent, read_regular(path, _MAX_SIZE, follow=True))
    except OSError as error:
        raise ConfigError(f"cannot read {path}: {error.strerror}") from error
