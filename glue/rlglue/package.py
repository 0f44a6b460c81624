"""The modules called rlglue and RlGlue that players import, provided where they are not installed.

RL-Glue's Python codec has never been released for Python 3; its players import little from it.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from importlib import import_module
from types import ModuleType
from typing import Any, Final, Protocol

from glue.errors import ConfigError
from glue.rlglue import values
from glue.rlglue.parser import TaskSpecParser


class _BaseAgent(Protocol):
    """The base class of agents of rlglue-andnp."""


class _BaseEnvironment(Protocol):
    """The base class of environments of rlglue-andnp."""


class _RlGlue:
    """The loop of rlglue-andnp, in whose place ours plays."""

    def __init__(self, agent: object, environment: object) -> None:
        names = " --env ".join(f"rlglue:FILE.py:{type(player).__name__}" for player in (agent, environment))
        raise ConfigError(f"run them with glue-experiment --agent {names}")


class _Agent:
    """The base class of agents of the codec."""


class _Environment:
    """The base class of environments of the codec."""


def _refusing(role: str) -> Callable[[object], None]:
    """Return a replacement for the codec's function that connects a player; it raises ConfigError."""

    def load(player: object) -> None:
        raise ConfigError(f"run it with glue-{role} rlglue:FILE.py:{type(player).__name__}")

    return load


_ANDNP: Final = {"BaseAgent": _BaseAgent, "BaseEnvironment": _BaseEnvironment, "RlGlue": _RlGlue}
_MODULES: Final[Mapping[str, Mapping[str, object]]] = {
    "rlglue": _ANDNP,
    "rlglue.types": {name: getattr(values, name) for name in values.__all__},
    "rlglue.agent": {"BaseAgent": _BaseAgent},
    "rlglue.agent.Agent": {"Agent": _Agent},
    "rlglue.agent.AgentLoader": {"loadAgent": _refusing("agent")},
    "rlglue.environment": {"BaseEnvironment": _BaseEnvironment},
    "rlglue.environment.Environment": {"Environment": _Environment},
    "rlglue.environment.EnvironmentLoader": {"loadEnvironment": _refusing("env")},
    "rlglue.utils": {},
    "rlglue.utils.TaskSpecVRLGLUE3": {"TaskSpecParser": TaskSpecParser},
    "RlGlue": _ANDNP,
    "RlGlue.agent": {"BaseAgent": _BaseAgent},
    "RlGlue.environment": {"BaseEnvironment": _BaseEnvironment},
}
"""Contents of each module, a package before its modules."""


def provide() -> None:
    """Make the modules importable: those that are installed and work, and ours in place of the others."""
    for name, contents in _MODULES.items():
        try:
            import_module(name)
        except (ImportError, SyntaxError):  # written for Python 2
            module: Any = ModuleType(name)
            module.__path__ = []
            vars(module).update(contents)
            sys.modules[name] = module
            package, _, attribute = name.rpartition(".")
            if package:
                setattr(sys.modules[package], attribute, module)
