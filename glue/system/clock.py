"""Time: reading it, waiting for it, and yielding the core."""

from __future__ import annotations

import os
import time
from typing import Final

monotonic: Final = time.monotonic
"""Seconds since an arbitrary time; never set back."""

unix: Final = time.time
"""Seconds since 1970, UTC, as this machine's clock says: it can be wrong, and be set."""

sleep: Final = time.sleep

give_way: Final = getattr(os, "sched_yield", lambda: None)
"""Yield this core: the peer that is to answer may be waiting for it."""
