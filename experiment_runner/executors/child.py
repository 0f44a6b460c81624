"""A program that ends when the one that started it does, whatever ends that, SIGKILL included.

    python -m experiment_runner.executors.child MODULE ARGUMENTS...

Its standard input is a pipe that nobody writes to: once it closes, whoever held the other end is gone.
"""

from __future__ import annotations

import os
import runpy
import sys
import threading

__all__ = ["main"]


def main() -> None:
    """Run a module as a program."""
    parent = os.dup(0)
    nothing = os.open(os.devnull, os.O_RDONLY)
    os.dup2(nothing, 0)  # who reads standard input finds its end, and does not wait for ever
    threading.Thread(target=_end_with, args=(parent,), daemon=True).start()
    module, *arguments = sys.argv[1:]
    sys.argv = [module, *arguments]
    runpy.run_module(module, run_name="__main__", alter_sys=True)


def _end_with(parent: int) -> None:
    os.read(parent, 1)
    os._exit(1)


if __name__ == "__main__":
    main()
