"""A hub in a process of its own, to be attacked:

    python -m tests.system.attacks.victim SETTINGS [KEYS]

`SETTINGS` are those of `HubConfig`, in JSON; `KEYS` is the directory of its keys.
"""

from __future__ import annotations

import json
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from glue.cli.hub import serve_until_interrupted
from glue.hub.config import Bind, HubConfig
from glue.keys.allowed import read_keys
from tests.scripted.process import address, running


class Victim:
    """A hub in a process.

    Attributes:
        url: its address.
        process: its process.
    """

    def __init__(self, url: str, process: subprocess.Popen[str]) -> None:
        self.url = url
        self.process = process

    def begin(self) -> int:
        """Forget the most memory that it has held so far; return what it holds now, in bytes."""
        Path(f"/proc/{self.process.pid}/clear_refs").write_text("5")
        return self._status("VmRSS")

    def most(self) -> int:
        """Return the most memory that it has held since `begin`, in bytes."""
        return self._status("VmHWM")

    def _status(self, name: str) -> int:
        status = Path(f"/proc/{self.process.pid}/status").read_text()
        return int(status.split(f"{name}:")[1].split()[0]) * 1024


@contextmanager
def victim(*, keys: Path | None = None, **settings: float) -> Iterator[Victim]:
    """Start a hub, which waits long for a HELLO and for peers that do not answer."""
    settings = {"timeout": 60.0, "greeting": 60.0, "farewell": 0.1} | settings
    arguments = [json.dumps(settings), *([] if keys is None else [str(keys)])]
    with running("-m", "tests.system.attacks.victim", *arguments) as process:
        url = address(process)
        assert process.stderr is not None
        threading.Thread(target=process.stderr.read, daemon=True).start()
        yield Victim(url, process)
        assert process.poll() is None, "the hub has died"


def _main(settings: str, keys: str = "") -> None:
    bind = Bind("tcp://127.0.0.1:*", keys=read_keys(Path(keys)) if keys else None)
    serve_until_interrupted(HubConfig(bind=(bind,), **json.loads(settings)))


if __name__ == "__main__":
    _main(*sys.argv[1:])
