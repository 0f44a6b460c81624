"""Fills every file system that it can write to, and gives up when no space is left anywhere."""

from __future__ import annotations

import os
import sys
from pathlib import Path

from tests.jails.hostile.honest import FOLDERS, Honest, play


class Fills(Honest):
    def misbehave(self) -> None:
        for folder in (*FOLDERS, "/dev", "/proc"):
            print(f"{folder}: {fill(Path(folder))}")
        os._exit(4)


def fill(folder: Path) -> str:
    """Write until writing fails; return the error, and how many MiB were written."""
    written, number = 0, 0
    try:
        while True:
            number += 1
            with (folder / f"junk{number}").open("wb", buffering=0) as file:
                while file.tell() < 2**30:
                    written += file.write(bytes(2**20))
    except OSError as error:
        return f"{error.strerror} after {written / 2**20:.0f} MiB"


if __name__ == "__main__":
    sys.stdout.reconfigure(line_buffering=True)  # type: ignore[union-attr]
    play(Fills())
