"""A process of one role, with a client of this project:

    python -m tests.scripted.process agent tcp://127.0.0.1:4097 tests.players:ScriptedAgent
    python -m tests.scripted.process agent tcp://127.0.0.1:4097 tests.system.conformance:agents libzmq

The third argument names a callable that returns the player, or a mapping of players by session. The fourth
connects through libzmq's DEALER instead of a plain socket. `main` does the same in a forked process.
"""

from __future__ import annotations

import importlib
import re
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from glue.client.players import serve_agent, serve_environment
from glue.errors import GlueError

ROOT = Path(__file__).parents[2]


@contextmanager
def running(*arguments: str) -> Iterator[subprocess.Popen[str]]:
    """Run a Python program with its standard error in a pipe; kill it at the end if it still runs."""
    process = subprocess.Popen(
        [sys.executable, *arguments], cwd=ROOT, stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    try:
        yield process
    finally:
        process.kill()
        process.communicate()


def address(hub: subprocess.Popen[str]) -> str:
    """Return the address that a hub prints first."""
    assert hub.stderr is not None
    return address_in(hub.stderr.readline())


def address_in(line: str) -> str:
    """Return the address in the line with which a hub begins."""
    listening = re.search(r"listening on (\S*[^\s:])", line)
    assert listening is not None, line
    return listening[1]


def main(role: str, hub: str, player: str, end: str = "plain") -> int:
    """Serve until the hub says goodbye."""
    serve = serve_agent if role == "agent" else serve_environment
    module, _, name = player.partition(":")
    made = getattr(importlib.import_module(module), name)()
    try:
        if end == "libzmq":
            import zmq

            with zmq.Context() as context:
                reason = serve(made, hub, context=context)
        else:
            reason = serve(made, hub)
        print("goodbye:", reason)
    except GlueError as error:
        print(f"Error: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
