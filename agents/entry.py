"""Where `glue-agent` begins; see `glue.entry`."""

from __future__ import annotations

from glue.entry import start


def agent() -> None:
    """Run `glue-agent`."""
    start("agents.command")
