"""Where `glue-env` and `glue-replay` begin; see `glue.entry`."""

from __future__ import annotations

from glue.entry import start


def environment() -> None:
    """Run `glue-env`."""
    start("env_server.command")


def replay() -> None:
    """Run `glue-replay`."""
    start("env_server.replay.command")
