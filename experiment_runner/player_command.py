"""Serve one agent or environment for a program that starts it as a child:

    python -P -m experiment_runner.player_command ROLE NAME OPTIONS HUB SESSION

OPTIONS is JSON. `glue-agent` and `glue-env` are the same for people.
"""

from __future__ import annotations

import json
import os
import signal
import sys
from collections.abc import Mapping, Sequence
from types import FrameType
from typing import Final, NoReturn

import click

from experiment_runner.rewards import FiniteRewards
from glue.client.players import serve_agent, serve_environment
from glue.commands import run
from glue.entry import EXIT_TERMINATED
from glue.errors import PeerFailed
from glue.options import Value
from glue.players.loading import construct, find
from glue.protocol.messages import Role

__all__ = ["MODULE", "arguments", "main"]

MODULE: Final = "experiment_runner.player_command"
"""What to start."""


def arguments(
    role: Role,
    name: str,
    options: Mapping[str, Value],
    hub: str,
    session: str,
    any_reward: bool = True,
    key: str | None = None,
    hub_key: str | None = None,
) -> Sequence[str]:
    """Return the arguments with which `MODULE` serves a player.

    Args:
        role: agent or environment.
        name: as `glue.players.loading.find` takes it.
        options: constructor options.
        hub: URL of the hub.
        session: name of the session.
        any_reward: whether an environment may give rewards that are infinite or not a number.
        key: file with the secret key by which the hub knows the player, if it does.
        hub_key: the hub's public key, or a file that holds it.
    """
    flags = ["--any-reward"] if any_reward else []
    keys = [f"--key={key}"] if key else []
    keys += [f"--hub-key={hub_key}"] if hub_key else []
    return [*flags, *keys, "--", str(role), name, json.dumps(dict(options)), hub, session]


@click.command()
@click.argument("role", type=click.Choice([str(Role.AGENT), str(Role.ENVIRONMENT)]))
@click.argument("name")
@click.argument("options")
@click.argument("hub")
@click.argument("session")
@click.option("--any-reward", is_flag=True)
@click.option("--key")
@click.option("--hub-key")
def serve(
    role: str,
    name: str,
    options: str,
    hub: str,
    session: str,
    any_reward: bool,
    key: str | None,
    hub_key: str | None,
) -> None:
    """Serve an agent or environment until the hub says goodbye."""
    # Ended while it is imported it is silent, too; see below.
    when_served = signal.signal(signal.SIGTERM, _end)
    try:
        player = construct(find(Role(role), name), json.loads(options))
        signal.signal(signal.SIGTERM, when_served)
        if role == Role.AGENT:
            serve_agent(player, hub, session, key=key, hub_key=hub_key, log=_ignore)
        else:
            checked = player if any_reward else FiniteRewards(player)
            serve_environment(checked, hub, session, key=key, hub_key=hub_key, log=_ignore)
    except PeerFailed as failure:
        if failure.__cause__ is None:
            raise
        sys.exit(1)  # the hub has received the reason, and our parent prints it
    except KeyboardInterrupt:
        sys.exit(EXIT_TERMINATED)  # in silence: our parent ended us, and says why


def _end(number: int, frame: FrameType | None) -> NoReturn:
    os._exit(EXIT_TERMINATED)


def _ignore(line: str) -> None:
    pass


def main() -> None:
    """Run the command."""
    run(serve)


if __name__ == "__main__":
    main()
