"""Where `glue-hub` begins; see `glue.entry`."""

from __future__ import annotations

from typing import NoReturn

from glue.entry import start


def hub() -> NoReturn:
    """Run `glue-hub`."""
    start("glue.hub.command")
