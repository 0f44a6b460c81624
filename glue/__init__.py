"""RL-Glue over ZeroMQ and msgpack: what agents, environments and experiments are written against.

    from glue import Action, serve_agent

The names below are imported when they are first used, so that `import glue` costs nothing.
"""

from __future__ import annotations

from importlib import import_module

TYPE_CHECKING = False  # not imported: see glue.entry
if TYPE_CHECKING:
    from typing import Any, Final

    from glue.client.experiment import connect
    from glue.client.players import serve_agent, serve_environment
    from glue.core.experiment import Experiment
    from glue.core.local import local
    from glue.errors import (
        ConfigError,
        ExperimentError,
        GlueError,
        HubClosed,
        HubUnreachable,
        LocalProtocolError,
        PeerFailed,
        PeerLost,
        Refused,
        RemoteProtocolError,
        TaskSpecError,
        Unsupported,
    )
    from glue.options import Option
    from glue.players.loading import make, make_agent
    from glue.roles import Agent, Environment
    from glue.runs import RunData, load_run
    from glue.types import CUT_OFF, Action, Observation

__version__ = "0.2.0"

__all__ = [
    "CUT_OFF",
    "Action",
    "Agent",
    "ConfigError",
    "Environment",
    "Experiment",
    "ExperimentError",
    "GlueError",
    "HubClosed",
    "HubUnreachable",
    "LocalProtocolError",
    "Observation",
    "Option",
    "PeerFailed",
    "PeerLost",
    "Refused",
    "RemoteProtocolError",
    "RunData",
    "TaskSpecError",
    "Unsupported",
    "__version__",
    "connect",
    "load_run",
    "local",
    "make",
    "make_agent",
    "serve_agent",
    "serve_environment",
]

_HOMES: Final = {
    "glue.client.experiment": ("connect",),
    "glue.client.players": ("serve_agent", "serve_environment"),
    "glue.core.experiment": ("Experiment",),
    "glue.core.local": ("local",),
    "glue.errors": (
        "ConfigError",
        "ExperimentError",
        "GlueError",
        "HubClosed",
        "HubUnreachable",
        "LocalProtocolError",
        "PeerFailed",
        "PeerLost",
        "Refused",
        "RemoteProtocolError",
        "TaskSpecError",
        "Unsupported",
    ),
    "glue.options": ("Option",),
    "glue.players.loading": ("make", "make_agent"),
    "glue.roles": ("Agent", "Environment"),
    "glue.runs": ("RunData", "load_run"),
    "glue.types": ("CUT_OFF", "Action", "Observation"),
}


def __getattr__(name: str) -> Any:
    for module, names in _HOMES.items():
        if name in names:
            found = globals()[name] = getattr(import_module(module), name)
            return found
    raise AttributeError(f"module 'glue' has no attribute {name!r}")


def __dir__() -> list[str]:
    return [*globals(), *__all__]
