"""Where `glue-agent` begins; see `glue.entry`."""

from __future__ import annotations

from typing import NoReturn

from glue.entry import start


def agent() -> NoReturn:
    """Run `glue-agent`."""
    start("agents.command")
