"""RL-Glue over ZeroMQ and msgpack: the library for writing agents, environments and experiments.

    from glue import Action, serve_agent

The public names, listed in `glue.api`, are imported when one is first used, so that `import glue`
costs nothing.
"""

from __future__ import annotations

from importlib import import_module

from glue.names import hidden_names

TYPE_CHECKING = False  # not imported: see glue.cli.entry
if TYPE_CHECKING:
    from typing import Any

    from glue.api import *  # noqa: F403

__version__ = "0.3.0"

if _hidden := hidden_names():
    import warnings

    warnings.warn(_hidden, stacklevel=2)


def __getattr__(name: str) -> Any:
    if name == "__all__":
        return __dir__()
    if not name.startswith("_"):
        public = vars(import_module("glue.api"))
        if name in public:
            return public[name]
    raise AttributeError(f"module 'glue' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({"__version__", *(name for name in vars(import_module("glue.api")) if name[0] != "_")})
