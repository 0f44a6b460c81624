"""Remove an entrant's container when the process that started it is gone, even if it was killed.

    python -P -m experiment_runner.competition.remover SOCKET CONTAINER

SOCKET is the container engine's. A launcher that removes the container itself kills this process.
"""

from __future__ import annotations

import signal
import sys
from contextlib import suppress
from typing import Final

from experiment_runner.processes.children import watch_parent

MODULE: Final = "experiment_runner.competition.remover"

_SECONDS: Final = 60.0


def main() -> None:
    """Wait for the end of the parent, and remove the container."""
    address, container = sys.argv[1:]
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)  # this process ends with its parent
    watch_parent(lambda: _remove(address, container)).join()


def _remove(address: str, container: str) -> None:
    """Ask the engine with one plain request; its SDK would take up memory all the time."""
    import socket

    request = f"DELETE /containers/{container}?force=1&v=1 HTTP/1.0\r\nHost: engine\r\n\r\n"
    # An engine that is gone has taken its containers with it.
    with suppress(OSError), socket.socket(socket.AF_UNIX) as engine:
        engine.settimeout(_SECONDS)
        engine.connect(address)
        engine.sendall(request.encode())
        engine.recv(1)  # the engine answers when it is done


if __name__ == "__main__":
    main()
