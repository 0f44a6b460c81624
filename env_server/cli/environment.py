"""`glue-env`: connect an environment to a hub."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Any, NoReturn

import click

from glue.cli.players import Extra, player_command
from glue.wire.messages import Role

if TYPE_CHECKING:
    from env_server.render.live import Rendered
    from glue.engine.checking import CheckedActions
    from glue.roles import Environment


def _rendered(player: Environment, _: bool) -> Rendered:
    """Return `player`, drawn in this terminal until the command ends for any reason."""
    from env_server.render import live
    from glue.cli.screen import TerminalScreen, renderer

    screen = TerminalScreen(sys.stdout, renderer(player))
    click.get_current_context().call_on_close(screen.close)
    return live.Rendered(player, screen)


def _checked(player: Environment, _: bool) -> CheckedActions:
    """Return `player`, which refuses illegal actions."""
    from glue.engine.checking import CheckedActions

    return CheckedActions(player)


def _print_level(player: Any, seed: int) -> NoReturn:
    """Print the level of a seed instead of serving."""
    sys.stdout.write(player.level_template(seed))
    click.get_current_context().exit()


environment: click.Group = player_command(
    Role.ENVIRONMENT,
    "  glue-env mario --render\n"
    "  glue-env mario --level-difficulty 1\n"
    "  glue-env mines --random-start --hub tcp://127.0.0.1:5000",
    Extra(
        click.Option(
            ["--check-actions", "_check_actions"],
            is_flag=True,
            help="Refuse an action that the task spec or the mask of the last observation forbids.",
        ),
        _checked,
    ),
    Extra(
        click.Option(["--render", "_render"], is_flag=True, help="Draw it in this terminal as it is played."),
        _rendered,
    ),
    Extra(
        click.Option(
            ["--level-template", "_level_template"],
            type=int,
            metavar="SEED",
            help="Print the level of this seed as a text picture for --level, and end.",
        ),
        _print_level,
        "level_template",
    ),
)
