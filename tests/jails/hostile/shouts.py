"""Prints endlessly."""

from __future__ import annotations

import sys

if __name__ == "__main__":
    while True:
        sys.stdout.write("shout\n" * 1000)
