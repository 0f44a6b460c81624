"""Where `glue-conform` begins; see `glue.entry`."""

from __future__ import annotations

from glue.entry import start


def conform() -> None:
    """Run `glue-conform`."""
    start("glue.testing.conform.command")
