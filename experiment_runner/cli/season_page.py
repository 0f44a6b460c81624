"""`glue-compete page`: the page of a season, whose options `serve` has, too."""

from __future__ import annotations

import ipaddress
import json
import os
import re
import sys
import threading
import warnings
from collections.abc import Callable
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, TextIO, TypeVar

import click

from experiment_runner.cli.options import place_of
from experiment_runner.view.launch import check_view
from glue.cli.shared import DIRECTORY
from glue.console import say
from glue.errors import ConfigError

if TYPE_CHECKING:
    from experiment_runner.view.server import Place

_Command = TypeVar("_Command", bound=Callable[..., Any])

_NICENESS: Final = 10
_ADDRESS: Final = re.compile(r"(?:\[([0-9A-Fa-f:.]+)\]|([^\s:/]+)):(\d{1,5})")


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
            if end and message:
                now = datetime.now(UTC).isoformat(timespec="milliseconds")
                self._stream.write(json.dumps({"time": now, "message": message}) + "\n")
        return len(text)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)


def _log(context: click.Context, option: click.Parameter, form: str) -> str:
    if form == "json":
        sys.stderr = _JsonLines(sys.stderr)
    return form


def _ip(context: click.Context, option: click.Parameter, text: str | None) -> str | None:
    try:
        return text and str(ipaddress.ip_address(text))
    except ValueError:
        raise click.BadParameter(f"{text} is not an IP address such as 172.30.97.1") from None


_OPTIONS: Final = (
    click.option(
        "--proxy",
        default="",
        metavar="URL",
        help="Address at which browsers find the page behind a proxy on this machine: https://lab.example/season",
    ),
    click.option(
        "--proxy-address",
        metavar="IP",
        callback=_ip,
        help="Address from which that proxy comes, if not from this machine, as for a page in a container.",
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
    """Give a command the options `proxy`, `proxy_address`, `insecure`, `publish` and `log_format`."""
    for option in reversed(_OPTIONS):
        command = option(command)
    return command


def place_of_page(address: str, proxy: str, insecure: bool) -> Place:
    """Return where a season's page is served.

    Args:
        address: such as 127.0.0.1:8097.
        proxy, insecure: as for `place_of`.

    Raises:
        ConfigError: the address is malformed; or as by `place_of`.
    """
    match = _ADDRESS.fullmatch(address)
    if match is None or int(match[3]) > 65535:
        raise ConfigError(f"--page is HOST:PORT, as in 127.0.0.1:8097, not {address}", settings=("page",))
    return place_of(match[1] or match[2], int(match[3]), proxy, insecure)


@click.command("page")
@click.argument("directory", type=DIRECTORY, metavar="DIR")
@click.option(
    "--page",
    "address",
    default="127.0.0.1:8097",
    show_default=True,
    metavar="HOST:PORT",
    help="Address of this machine to listen at; port 0 for any that is free.",
)
@page_options
def page(
    directory: Path,
    address: str,
    proxy: str,
    proxy_address: str | None,
    insecure: bool,
    publish: Path | None,
    log_format: str,
) -> None:
    """Show the season in DIR on a page that is open to all; `serve` does so, too.

    The page also shows a season that is over, and what a server that does not run has left.
    """
    warnings.simplefilter("ignore", RuntimeWarning)  # NumPy's: returns may be infinite or NaN
    check_view("page")
    from experiment_runner.competition.records.journal import utc_now
    from experiment_runner.competition.season.board import PUBLIC
    from experiment_runner.competition.season.entrance import routes
    from experiment_runner.view.season.page import Passing, season_page
    from experiment_runner.view.season.publish import Publisher
    from experiment_runner.view.season.views import Views, organisers_token
    from experiment_runner.view.server import serve

    place = place_of_page(address, proxy, insecure)
    os.nice(_NICENESS)  # what is played has priority
    views = Views(directory, utc_now)
    views.board(PUBLIC)  # says why, if the directory holds no season
    token = organisers_token(directory)
    if publish is not None:
        Publisher(views, publish).keep(say)

    def ready(url: str) -> None:
        say(f"the page is at {url}; the organiser's, which shows all: {url}?token={token}")

    entrance = partial(routes, proxy=proxy_address)
    serve(lambda address, _: season_page(views, address, entrance), place, ready, Passing)
