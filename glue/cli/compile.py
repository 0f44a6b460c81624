"""`glue-compile`: compile agents and environments ahead of time, so that no experiment waits."""

from __future__ import annotations

from functools import partial

import click

from glue import __version__
from glue.console import say
from glue.errors import ConfigError, GlueError
from glue.plugins.loading import make, make_agent, names
from glue.wire.messages import Role


@click.command("glue-compile")
@click.argument("players", metavar="[NAME]...", nargs=-1)
@click.version_option(__version__, prog_name="glue-compile")
def compile_players(players: tuple[str, ...]) -> None:
    """Compile agents and environments to machine code, which is kept on disk.

    Without a NAME, compile all installed ones. Each agent plays one step of an environment that it can play.

    \b
    Examples:
      glue-compile
      glue-compile mario hierarchical
      glue-compile gymnasium:env_server.gym:glue/InfiniteMario-v0
    """
    from glue.plugins.batched import make_batch

    agents = [name for name in players or names(Role.AGENT) if name in names(Role.AGENT)]
    environments = [name for name in players or names(Role.ENVIRONMENT) if name not in agents]
    for name in environments:
        for environment in (make(name), make_batch(name, partial(make, name), 1)):
            environment.env_init()
            environment.env_start()
            environment.env_cleanup()
        say(f"environment {name} is compiled")
    for name in agents:
        say(f"agent {name} {_play(name)}")


def _play(name: str) -> str:
    """Let an agent play a step of the first environment that it accepts; return the result in words."""
    from glue.engine.local import local

    try:
        agent = make_agent(name)
    except ConfigError as error:
        return f"is left out: {error}"
    for environment in names(Role.ENVIRONMENT):
        try:
            with local(agent, make(environment)) as glue:
                glue.rl_init()
                glue.rl_start()
                glue.rl_step()
                return "is compiled"
        except GlueError:
            continue
    return "is left out: it plays none of the installed environments"
