"""Where `glue-env` and `glue-replay` begin; see `glue.entry`."""

from __future__ import annotations

from typing import NoReturn

from glue.entry import start


def environment() -> NoReturn:
    """Run `glue-env`."""
    start("env_server.command")


def replay() -> NoReturn:
    """Run `glue-replay`."""
    start("env_server.replay.command")
