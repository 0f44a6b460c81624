"""What all tests share: their own helper modules can be imported, as `tests.players` and the like."""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))
