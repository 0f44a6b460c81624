"""Serve one agent or environment for a program that starts it as a child:

    python -P -m experiment_runner.executors.player_command ROLE NAME SETTINGS

SETTINGS is JSON: the player's `options`, whether an environment may give `any_reward` and has to
`check_actions`, and the `place` of its hub, as `serve_agent` takes it. `glue-agent` and `glue-env` do the
same for users.
"""

from __future__ import annotations

import json
import os
import signal
import sys
from collections.abc import Mapping
from types import FrameType
from typing import Any, Final, NoReturn

import glue.system.forks  # noqa: F401  # for the handlers that are set here
from experiment_runner.executors.rewards import FiniteRewards
from glue.client.players import serve_agent, serve_environment
from glue.console import LOG, leave_printing_to_others, say
from glue.engine.checking import CheckedActions
from glue.errors import GlueError, PeerFailed
from glue.plugins.loading import construct, find
from glue.wire.messages import Role

MODULE: Final = "experiment_runner.executors.player_command"
"""The module that serves a player in a separate process."""

_TERMINATED: Final = 128 + signal.SIGTERM
"""Exit status after SIGTERM."""


def main() -> None:
    """Serve an agent or environment until the hub says goodbye.

    Our parent ends us by SIGTERM and says why, so we exit silently.
    """
    role, name, text = sys.argv[1:]
    settings = json.loads(text)
    signal.signal(signal.SIGTERM, _end)
    try:
        _serve(Role(role), construct(find(Role(role), name), settings["options"]), settings)
    except PeerFailed as failure:
        if failure.__cause__ is None:
            _fail(failure)
        sys.exit(1)  # the hub has received the reason, and our parent prints it
    except GlueError as error:
        _fail(error)
    except KeyboardInterrupt:
        sys.exit(_TERMINATED)


def _serve(role: Role, player: Any, settings: Mapping[str, Any]) -> None:
    signal.signal(signal.SIGTERM, _interrupt)  # from now on there is something to clean up
    leave_printing_to_others()
    LOG.disabled = True  # our parent reports instead
    if role is Role.AGENT:
        serve_agent(player, **settings["place"])
    else:
        checked = player if settings["any_reward"] else FiniteRewards(player)
        serve_environment(
            CheckedActions(checked) if settings["check_actions"] else checked, **settings["place"]
        )


def _fail(error: GlueError) -> NoReturn:
    say(f"Error: {error}")
    sys.exit(1)


def _end(number: int, frame: FrameType | None) -> NoReturn:
    os._exit(_TERMINATED)


def _interrupt(number: int, frame: FrameType | None) -> NoReturn:
    raise KeyboardInterrupt


if __name__ == "__main__":
    main()
