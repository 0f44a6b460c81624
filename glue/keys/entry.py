"""Where `glue-keys` begins; see `glue.entry`."""

from __future__ import annotations

from typing import NoReturn

from glue.entry import start


def keys() -> NoReturn:
    """Run `glue-keys`."""
    start("glue.keys.command")
