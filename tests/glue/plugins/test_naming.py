"""A player's option given as an option of the command: the error says how to write it."""

from __future__ import annotations

import click
import pytest
from click.testing import CliRunner

from glue.plugins.naming import NamingCommand


@click.command(cls=NamingCommand)
@click.option("--agent")
@click.option("--env")
def command(agent: str | None, env: str | None) -> None:
    pass


@pytest.mark.parametrize(
    ("arguments", "remedy"),
    [
        ("--agent sarsa --epsilon 0.2", "--agent-option epsilon=0.2"),
        ("--agent=sarsa --epsilon=0.2", "--agent-option epsilon=0.2"),
        ("--agent sarsa --epsilon", "--agent-option epsilon=VALUE"),
        ("--env mines --random-start", "--env-option random_start=on"),
        ("--agent sarsa --env mines --no-random-start", "--env-option random_start=off"),
        ("--agent sarsa --nonsense 1", "No such option"),
        ("--agent nobody --epsilon 0.2", "No such option"),
    ],
)
def test_an_option_of_a_player_is_recognised(arguments: str, remedy: str) -> None:
    result = CliRunner().invoke(command, arguments.split())
    assert result.exit_code == 2
    assert remedy in result.output
