"""Leaves traces for its next process wherever it can, and plays fair if it finds none."""

from __future__ import annotations

import subprocess
import sys
from contextlib import suppress
from pathlib import Path

from tests.jails.hostile.honest import FOLDERS, Honest, play

_NAME = "from-the-process-before"

if __name__ == "__main__":
    found = [folder for folder in FOLDERS if Path(folder, _NAME).exists()]
    found += [
        str(other) for other in Path("/proc").glob("[0-9]*") if _NAME in (other / "cmdline").read_text()
    ]
    if found:
        print(f"found in {', '.join(found)}")
        sys.exit(7)
    for folder in FOLDERS:
        with suppress(OSError):
            Path(folder, _NAME).write_text("hello")
            print(f"left in {folder}")
    subprocess.Popen(["sh", "-c", f"while :; do sleep 100; done; : {_NAME}"], start_new_session=True)
    play(Honest())
