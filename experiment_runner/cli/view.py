"""`glue-view`: a page of runs, in the browser."""

from __future__ import annotations

import os
import sys
import threading
import warnings
import webbrowser
from pathlib import Path
from typing import Final

import click

from experiment_runner.cli.options import place_of
from experiment_runner.view.launch import check_view
from glue import __version__
from glue.cli.shared import DIRECTORY
from glue.errors import ConfigError

_LOOPBACK: Final = "127.0.0.1"
_DEFAULT_FOLDER: Final = Path("runs")
_NICENESS: Final = 10


@click.command("glue-view")
@click.argument("directories", metavar="[DIR]...", nargs=-1, type=DIRECTORY)
@click.option(
    "--port",
    type=click.IntRange(0, 65535),
    metavar="N",
    help="Port to listen at, 0 for any. [default: 8097, or any if that is taken]",
)
@click.option("--stderr", is_flag=True, hidden=True)  # standard output is the experiment's
@click.option("--no-browser", is_flag=True, help="Do not open a browser; only print the address.")
@click.option(
    "--host",
    default=_LOOPBACK,
    show_default=True,
    metavar="ADDRESS",
    help="Address of this machine to listen at.",
)
@click.option(
    "--insecure",
    is_flag=True,
    help="Allow a --host that other machines can reach: nothing is encrypted, not even the token.",
)
@click.option(
    "--proxy",
    default="",
    metavar="URL",
    help="Address at which browsers find the page behind a proxy on this machine: https://lab.example/runs",
)
@click.version_option(__version__, prog_name="glue-view")
def view(
    directories: tuple[Path, ...],
    port: int | None,
    no_browser: bool,
    host: str,
    insecure: bool,
    proxy: str,
    stderr: bool,
) -> None:
    """Show the runs in each DIR (by default runs) on a page in the browser, until Ctrl-C.

    A DIR is a run, or a folder of runs, which may be under way: they are only read. The page is served only
    on this machine, and opens with the token in the printed address: docs/view.md.

    \b
    Examples:
      glue-view
      glue-view runs/mine /data/mario --no-browser
      glue-view --port 9000 --proxy https://lab.example/runs
    """
    warnings.simplefilter("ignore", RuntimeWarning)  # NumPy's: returns may be infinite or NaN
    for directory in directories:
        if not directory.is_dir():
            raise ConfigError(f"there is no folder {directory}")
    check_view()
    from experiment_runner.view.app import page
    from experiment_runner.view.catalog import address_of
    from experiment_runner.view.server import new_token, serve

    place = place_of(host, port, proxy, insecure)
    os.nice(_NICENESS)  # the runs have priority
    shown = directories or (_DEFAULT_FOLDER,)

    token = new_token()

    def ready(url: str) -> None:
        url += f"?token={token}{address_of(shown)}"
        click.echo(f"the page is at {url}", err=stderr)
        if not no_browser and _has_display():
            # open() may wait for the browser.
            threading.Thread(target=webbrowser.open, args=(url,), daemon=True).start()

    serve(lambda address, pulse: page(shown, address, token, pulse), place, ready)


def _has_display() -> bool:
    """Return whether a browser can open a window; otherwise Python would run a text browser."""
    return sys.platform == "darwin" or any(map(os.environ.get, ("DISPLAY", "WAYLAND_DISPLAY")))
