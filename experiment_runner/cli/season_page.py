"""`glue-compete page`: the page of a season."""

from __future__ import annotations

import os
import re
import warnings
from pathlib import Path
from typing import Final

import click

from experiment_runner.cli.options import place_of
from experiment_runner.cli.season_options import page_options
from experiment_runner.view.launch import check_view
from glue.cli.shared import DIRECTORY
from glue.console import say
from glue.errors import ConfigError

_NICENESS: Final = 10
_ADDRESS: Final = re.compile(r"(?:\[([0-9A-Fa-f:.]+)\]|([^\s:/]+)):(\d{1,5})")


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
    directory: Path, address: str, proxy: str, insecure: bool, publish: Path | None, log_format: str
) -> None:
    """Show the season in DIR on a page that is open to all; `serve` does so, too.

    The page also shows a season that is over, and what a server that does not run has left.
    """
    warnings.simplefilter("ignore", RuntimeWarning)  # NumPy's: returns may be infinite or NaN
    check_view("page")
    from experiment_runner.competition.records.journal import utc_now
    from experiment_runner.competition.season.entrance import routes
    from experiment_runner.view.season.page import Passing, season_page
    from experiment_runner.view.season.publish import Publisher
    from experiment_runner.view.season.views import Views, organisers_token
    from experiment_runner.view.server import serve

    match = _ADDRESS.fullmatch(address)
    if match is None or int(match[3]) > 65535:
        raise ConfigError(f"--page is HOST:PORT, as in 127.0.0.1:8097, not {address}", settings=("page",))
    place = place_of(match[1] or match[2], int(match[3]), proxy, insecure)
    views = Views(directory, utc_now)
    views.viewers()  # says why, if the directory holds no season
    token = organisers_token(directory)
    os.nice(_NICENESS)  # what is played has priority
    if publish is not None:
        Publisher(views, publish).keep(say)

    def ready(url: str) -> None:
        say(f"the page is at {url}; the organiser's, which shows all: {url}?token={token}")

    serve(lambda address, _: season_page(views, address, routes), place, ready, Passing)
