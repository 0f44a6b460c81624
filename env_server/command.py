"""`glue-env`: connect an environment to a hub."""

from __future__ import annotations

import sys

import click

from env_server.render.live import Rendered
from env_server.render.text import TerminalScreen
from glue.client.players import serve_environment
from glue.commands import Extra, player_command, run
from glue.protocol.messages import Role

__all__ = ["environment", "main"]

environment = player_command(
    Role.ENVIRONMENT,
    "glue-env",
    lambda players, hub, log: serve_environment(players, hub, log=log),
    "Connect an environment to a hub, and serve until the hub says goodbye.",
    "  glue-env mines\n"
    "  glue-env mario --level-difficulty 1 --render\n"
    "  glue-env mines --random-start --hub tcp://127.0.0.1:5000",
    Extra(
        click.Option(["--render", "_render"], is_flag=True, help="Draw it in this terminal as it is played."),
        lambda player, _: Rendered(player, TerminalScreen(sys.stdout)),
    ),
)


def main() -> None:
    """Run `glue-env`."""
    run(environment)


if __name__ == "__main__":
    main()
