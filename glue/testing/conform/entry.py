"""Where `glue-conform` begins; see `glue.entry`."""

from __future__ import annotations

from typing import NoReturn

from glue.entry import start


def conform() -> NoReturn:
    """Run `glue-conform`."""
    start("glue.testing.conform.command")
