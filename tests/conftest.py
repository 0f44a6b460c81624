"""What all tests share: their own modules can be imported, as `tests.players` and the like; Ctrl-C works."""

from __future__ import annotations

import signal
import sys
from pathlib import Path

from hypothesis import settings

sys.path.insert(0, str(Path(__file__).parents[1]))

# Where a shell has put us in the background it may have interrupts ignored, and so would all that we start.
signal.signal(signal.SIGINT, signal.default_int_handler)

# No test asserts on time: the first example of a property may have to compile or import.
settings.register_profile("glue", deadline=None)
settings.load_profile("glue")
