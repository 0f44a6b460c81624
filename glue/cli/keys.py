"""`glue-keys`: make and show the keys by which a hub recognises its peers."""

from __future__ import annotations

from pathlib import Path

import click

from glue import __version__
from glue.cli.shared import DIRECTORY
from glue.console import say
from glue.keys.certificates import encode, read_public, write_pair


@click.group("glue-keys")
@click.version_option(__version__, prog_name="glue-keys")
def keys() -> None:
    """Make and show the keys by which a hub recognises who connects, and which encrypt the connection.

    \b
    Examples:
      glue-keys new hub --dir keys
      glue-keys new carol
      glue-hub --bind tcp://*:4097 --keys keys
      glue-agent sarsa --hub tcp://HOST:4097 --key carol.key_secret --hub-key hub.key
    """


@keys.command()
@click.argument("name")
@click.option(
    "--dir",
    "directory",
    type=DIRECTORY,
    default=Path(),
    metavar="DIR",
    help="Where to write the two files. [default: the working directory]",
)
def new(name: str, directory: Path) -> None:
    """Make a pair: NAME.key to hand out, and NAME.key_secret to keep."""
    from glue.client.libzmq import new_pair

    public, secret = write_pair(directory, name, new_pair())
    say(f"{secret}: the secret key. Do not share it; it is for --key, or for --keys if it is the hub's")
    say(f"{public}: the public key. Give it to the operator of the hub; a hub's own, to all who join it")
    click.echo(encode(read_public(public)))


@keys.command()
@click.argument("file", metavar="file")
def show(file: str) -> None:
    """Print the public key in FILE, which may be either of the two files of a pair."""
    click.echo(encode(read_public(file, "file")))
