"""Remove an entrant's container when the process that started it is gone, even if that was killed.

    python -P -m experiment_runner.competition.remover SOCKET CONTAINER

SOCKET is that of the container engine. Standard input is a pipe to which nothing is written: when it closes,
nobody else is left to remove the container. A starter that removes it itself then kills this process.
"""

from __future__ import annotations

import signal
import sys
from contextlib import suppress
from typing import Final

__all__ = ["MODULE", "main"]

MODULE: Final = "experiment_runner.competition.remover"

_SECONDS: Final = 60.0


def main() -> None:
    """Wait for the end of standard input, and remove the container."""
    address, container = sys.argv[1:]
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)  # it ends with its standard input
    sys.stdin.buffer.read()
    with suppress(OSError):  # the engine is gone, and with it its containers
        _remove(address, container)


def _remove(address: str, container: str) -> None:
    """Ask the engine: one request, for which its SDK would take up memory all the time.

    Raises:
        OSError: the engine does not answer.
    """
    import socket

    request = f"DELETE /containers/{container}?force=1&v=1 HTTP/1.0\r\nHost: engine\r\n\r\n"
    with socket.socket(socket.AF_UNIX) as engine:
        engine.settimeout(_SECONDS)
        engine.connect(address)
        engine.sendall(request.encode())
        engine.recv(1)  # it answers when it is done


if __name__ == "__main__":
    main()
