"""Limits of a recording, for writer and reader alike; see docs/trajectories.md."""

from __future__ import annotations

from typing import Final

MAX_BODY: Final = 16 * 2**20  # bytes of one observation or action
MAX_TEXT: Final = 16 * 2**20  # bytes of one run's JSON, or of one message
MAX_EPISODE: Final = 256 * 2**20  # bytes of all records of one episode and those before it, unpacked
MAX_STEPS: Final = 1_000_000  # of one episode; and messages before it, answers, and blocks
MAX_BLOCK: Final = 2**16  # steps of one block of an actions-only episode
MAX_RUN_SYNTAX: Final = 2**16  # characters of a run's JSON without the contents of its texts
