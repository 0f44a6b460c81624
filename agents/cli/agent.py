"""`glue-agent`: connect an agent to a hub."""

from __future__ import annotations

import click

from glue.cli.players import Extra, player_command
from glue.cli.shared import FILE
from glue.plugins.loading import load_trained
from glue.wire.messages import Role

agent: click.Group = player_command(
    Role.AGENT,
    "  glue-agent hierarchical\n"
    "  glue-agent sarsa --step-size 0.1 --hub tcp://127.0.0.1:5000\n"
    "  glue-agent hierarchical --load mario.agent --no-learning --epsilon 0\n"
    "  glue-agent my.py:Agent --season season.toml\n"
    "  glue-agent --season season.toml ./my-program",
    Extra(
        click.Option(
            ["--load", "_load"],
            type=FILE,
            help="Load what an agent of this kind has learned, and the state of its random generator, from "
            "this file of `glue-results agent`.",
        ),
        load_trained,
    ),
)
