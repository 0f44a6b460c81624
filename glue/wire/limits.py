"""Limits of the protocol; see docs/protocol.md."""

from __future__ import annotations

from typing import Final

MAX_HEADER: Final = 4096
"""The largest header, in bytes. The longest legal one, a HELLO, stays far below."""

MAX_BODY: Final = 16 * 2**20
"""The largest body, in bytes: room for RL-Glue's million ints, million doubles and million chars."""

MAX_NAME: Final = 255
"""The longest session or peer name, in characters."""
