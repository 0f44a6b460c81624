"""Limits of the protocol; see docs/protocol-reference.md."""

from __future__ import annotations

from typing import Final

MAX_HEADER: Final = 4096
"""Maximum size of a header, in bytes. The longest legal header, that of a HELLO, is far smaller."""

MAX_BODY: Final = 16 * 2**20
"""Maximum size of a body, in bytes: room for RL-Glue's million ints, million doubles and million chars."""

MAX_NAME: Final = 255
"""Maximum length of a session or peer name, in characters."""
