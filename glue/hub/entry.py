"""Where `glue-hub` begins; see `glue.entry`."""

from __future__ import annotations

from glue.entry import start


def hub() -> None:
    """Run `glue-hub`."""
    start("glue.hub.command")
