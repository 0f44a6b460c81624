"""Commands in a terminal of their own, and their output there."""

from __future__ import annotations

import os
import pty
import re
import signal
import subprocess
import tempfile
import termios
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final

from tests.forked import BIN, start

_ESCAPE: Final = re.compile(r"\x1b\[[0-9;?]*[A-Za-z]")


def run_anew(*command: str, cwd: Path, timeout: float = 120) -> subprocess.CompletedProcess[str]:
    """Run a command like `tests.forked.run`, but with all imports, to test its start-up."""
    return subprocess.run(
        [BIN / command[0], *command[1:]],
        cwd=cwd,
        timeout=timeout,
        capture_output=True,
        text=True,
        stdin=subprocess.DEVNULL,
    )


class Terminal:
    """One of our commands while it runs; tests can wait for its output on either stream."""

    def __init__(self, *command: str, cwd: Path) -> None:
        self._folder = tempfile.TemporaryDirectory()
        self._pipe = Path(self._folder.name) / "pipe"
        os.mkfifo(self._pipe)
        self.process = start(*command, cwd=cwd, printed=[self._pipe, self._pipe])
        self.lines: list[str] = []
        self._news = threading.Condition()
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def _read(self) -> None:
        with self._pipe.open(encoding="utf-8") as printed:
            for line in printed:
                with self._news:
                    self.lines.append(line.rstrip("\n"))
                    self._news.notify_all()

    def wait_for(self, pattern: str) -> re.Match[str]:
        with self._news:
            assert self._news.wait_for(lambda: self._find(pattern) is not None, 120), self.lines
            found = self._find(pattern)
            assert found is not None
            return found

    def _find(self, pattern: str) -> re.Match[str] | None:
        return next((match for line in self.lines if (match := re.search(pattern, line))), None)

    def send_signal(self, number: signal.Signals) -> None:
        os.kill(self.process.pid, number)

    def end(self) -> int:
        """Wait for the command to end; return its exit status."""
        status = self.process.wait(120)
        assert status is not None, self.lines
        self._reader.join()
        return status

    def close(self) -> None:
        self.process.kill()
        self._reader.join()
        self._folder.cleanup()


def run_in_terminal(*command: str, cwd: Path, columns: int = 80) -> tuple[int, str]:
    """Run one of our commands in a terminal; return its exit status and everything written there."""
    with watched_terminal() as (writing, seen):
        termios.tcsetwinsize(writing, (24, columns))
        process = subprocess.Popen(
            [BIN / command[0], *command[1:]],
            cwd=cwd,
            env={name: value for name, value in os.environ.items() if name != "COLUMNS"} | {"TERM": "xterm"},
            stdin=writing,
            stdout=writing,
            stderr=writing,
        )
        try:
            status = process.wait(120)
        finally:
            process.kill()
    return status, b"".join(seen).decode()


@contextmanager
def watched_terminal() -> Iterator[tuple[int, list[bytes]]]:
    """Yield a terminal's descriptor, and the output written to it, complete once the context has ended."""
    looking, writing = pty.openpty()
    seen: list[bytes] = []
    reader = threading.Thread(target=lambda: seen.extend(iter(lambda: _read(looking), b"")))
    reader.start()
    try:
        yield writing, seen
    finally:
        os.close(writing)
        reader.join()
        os.close(looking)


def drawings(text: str) -> list[str]:
    """Return the drawings in a terminal's output, each without its colors."""
    return [_ESCAPE.sub("", part).replace("\r", "") for part in text.split("\x1b[H")[1:]]


def _read(descriptor: int) -> bytes:
    try:
        return os.read(descriptor, 2**16)
    except OSError:  # Linux raises this when the last writer has closed a terminal.
        return b""
