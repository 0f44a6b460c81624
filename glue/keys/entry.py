"""Where `glue-keys` begins; see `glue.entry`."""

from __future__ import annotations

from glue.entry import start


def keys() -> None:
    """Run `glue-keys`."""
    start("glue.keys.command")
