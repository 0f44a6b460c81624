"""The other end of a hub: what connects an agent, an environment or an experiment to it."""

from typing import NoReturn


def __getattr__(name: str) -> NoReturn:
    """Name the new place of what could be imported from here in version 0.1."""
    if name in ("connect", "serve_agent", "serve_environment"):
        raise ImportError(f"glue.client.{name} has moved: write `from glue import {name}`")
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
