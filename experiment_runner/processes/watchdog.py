"""Processes that notice the end of the process that started them, even if SIGKILL ends it.

The standard input of such a child is a pipe to which nothing is written: when it closes, the parent has
ended, or has no more use for the child. Only the standard library is imported, to keep small children small.
"""

from __future__ import annotations

import os
import subprocess
import sys
import threading
from collections.abc import Callable, Mapping, Sequence


def spawn(
    module: str,
    arguments: Sequence[str],
    *,
    env: Mapping[str, str] | None = None,
    pass_fds: Sequence[int] = (),
) -> subprocess.Popen[bytes]:
    """Start a module that calls `watch_parent`.

    Ctrl-C in the terminal is not delivered to it. The working directory is not on its module path, where a
    file called random.py would break it.

    Args:
        module: run as `python -m` does.
        arguments: of its command line.
        env: its environment variables; None for those of this process.
        pass_fds: descriptors that it inherits.

    Raises:
        OSError: it cannot be started.
    """
    # A new program rather than a fork, which would share the lock of the run directory.
    return subprocess.Popen(
        [sys.executable, "-P", "-m", "glue_rl", module, *arguments],
        stdin=subprocess.PIPE,
        env=env,
        pass_fds=pass_fds,
        process_group=0,
    )


def watch_parent(ended: Callable[[], object]) -> threading.Thread:
    """Call `ended` in a thread, which is returned, when the parent ends or closes our standard input.

    Standard input is replaced, and a program that reads it gets end of file at once.
    """
    parent = os.dup(0)
    nothing = os.open(os.devnull, os.O_RDONLY)
    os.dup2(nothing, 0)
    os.close(nothing)

    def watch() -> None:
        os.read(parent, 1)
        ended()

    thread = threading.Thread(target=watch, name="parent", daemon=True)
    thread.start()
    return thread
