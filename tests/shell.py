"""Shell scripts, run by bash: our commands in them are forked, see `tests.forked`.

A command started by another one, as in `timeout 5 glue-experiment`, starts as it does for users.
"""

from __future__ import annotations

import json
import os
import shlex
import socketserver
import subprocess
import sys
import tempfile
import threading
from pathlib import Path
from typing import Final

from tests.forked import BIN, start

_ASKING: Final = Path(__file__).parent / "scripted" / "asking.py"


def bash(text: str, cwd: Path, timeout: float) -> subprocess.CompletedProcess[str]:
    """Run a script to its end, or to the first command that fails."""
    with (
        tempfile.TemporaryDirectory() as folder,
        socketserver.ThreadingUnixStreamServer(f"{folder}/socket", _Forking) as server,
    ):
        asking = shlex.join([sys.executable, "-ISE", str(_ASKING), f"{folder}/socket"])
        functions = [f'{command.name}() {{ ask {command.name} "$@"; }}' for command in BIN.glob("glue-*")]
        text = "\n".join([f'ask() {{ {asking} "$@"; }}', *functions, text])
        threading.Thread(target=server.serve_forever, args=(0.05,)).start()
        try:
            return subprocess.run(
                ["bash", "-euo", "pipefail", "-c", text],
                cwd=cwd,
                env={**os.environ, "PATH": f"{BIN}{os.pathsep}{os.environ['PATH']}"},
                capture_output=True,
                text=True,
                timeout=timeout,
            )
        finally:
            server.shutdown()


class _Forking(socketserver.StreamRequestHandler):
    """Runs a command for a process of `tests/scripted/asking.py`, and answers with its exit status."""

    def handle(self) -> None:
        asked = json.loads(self.rfile.readline())
        printed = [Path(f"/proc/{asked['pid']}/fd/{descriptor}") for descriptor in (1, 2)]
        process = start(*asked["command"], cwd=Path(asked["cwd"]), env=asked["env"], printed=printed)
        status = process.wait()
        assert status is not None
        self.wfile.write(b"%d\n" % (status if status >= 0 else 128 - status))
