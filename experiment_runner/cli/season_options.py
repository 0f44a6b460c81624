"""Options of the commands that serve a season or show its page."""

from __future__ import annotations

import json
import sys
import threading
from collections.abc import Callable
from datetime import UTC, datetime
from typing import Any, Final, TextIO, TypeVar

import click

from glue.cli.shared import DIRECTORY

_Command = TypeVar("_Command", bound=Callable[..., Any])


class _JsonLines:
    """Standard error, on which each line becomes a JSON object, with its time.

    Args:
        stream: receives the objects, one a line.
    """

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream
        self._begun = ""
        self._lock = threading.Lock()

    def write(self, text: str) -> int:
        """Write what is complete of a text; lines that come in one piece are one message."""
        with self._lock:
            message, end, self._begun = (self._begun + text).rpartition("\n")
            if end:
                now = datetime.now(UTC).isoformat(timespec="milliseconds")
                self._stream.write(json.dumps({"time": now, "message": message}) + "\n")
        return len(text)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)


def _log(context: click.Context, option: click.Parameter, form: str) -> str:
    if form == "json":
        sys.stderr = _JsonLines(sys.stderr)
    return form


_OPTIONS: Final = (
    click.option(
        "--proxy",
        default="",
        metavar="URL",
        help="Address at which browsers find the page behind a proxy on this machine: https://lab.example/season",
    ),
    click.option(
        "--insecure",
        is_flag=True,
        help="Allow a --page that other machines can reach: nothing is encrypted, not even tokens.",
    ),
    click.option(
        "--publish",
        type=DIRECTORY,
        metavar="DIR",
        help="Folder into which the public page is written every minute, as files for any web server.",
    ),
    click.option(
        "--log-format",
        type=click.Choice(["text", "json"]),
        default="text",
        show_default=True,
        is_eager=True,
        callback=_log,
        help="Lines of the log: for people, or a JSON object each with time and message.",
    ),
)


def page_options(command: _Command) -> _Command:
    """Give a command the options `proxy`, `insecure`, `publish` and `log_format`."""
    for option in reversed(_OPTIONS):
        command = option(command)
    return command
