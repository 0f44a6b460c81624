"""Where every command begins: its entry point here is a name of the table; see `glue.cli.entry`."""

from __future__ import annotations

from glue.cli.entry import start

TYPE_CHECKING = False  # not imported: see glue.cli.entry
if TYPE_CHECKING:
    from collections.abc import Callable
    from typing import Final, NoReturn

COMMANDS: Final = {
    "agent": "agents.cli.agent",
    "compete": "experiment_runner.cli.compete",
    "compile_players": "glue.cli.compile",
    "conform": "glue.cli.conform",
    "environment": "env_server.cli.environment",
    "experiment": "experiment_runner.cli.experiment",
    "generalise": "experiment_runner.cli.generalise",
    "hub": "glue.cli.hub",
    "keys": "glue.cli.keys",
    "paper": "experiment_runner.cli.paper",
    "plot": "experiment_runner.cli.plot",
    "replay": "env_server.cli.replay",
    "results": "experiment_runner.cli.results",
    "view": "experiment_runner.cli.view",
    "watch": "experiment_runner.cli.watch",
}
"""The module in which each command is defined, under the same name."""


def __getattr__(name: str) -> Callable[[], NoReturn]:
    if name not in COMMANDS:
        raise AttributeError(f"there is no command {name}")
    return lambda: start(COMMANDS[name], name)
