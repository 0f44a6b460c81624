"""Random bytes: identities, keys and nonces. Seeds of players and experiments never come from here."""

from __future__ import annotations

import os
from typing import Final

random_bytes: Final = os.urandom
"""Function that returns the requested number of unpredictable bytes."""
