"""Connect agent, environment and experiment: in this process, or over a hub.

Players that a trial names are created here, as objects or as child processes; see
`experiment_runner.executors.over_hub` for those that are not in this process.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import AbstractContextManager
from typing import Any

from experiment_runner.executors.job import Placement, Report
from experiment_runner.executors.rewards import FiniteRewards
from experiment_runner.plan.plan import TrialSpec
from glue.engine.checking import CheckedActions
from glue.engine.experiment import Experiment
from glue.engine.local import local
from glue.errors import ExperimentError
from glue.plugins.loading import construct, find
from glue.wire.messages import Role


def open_experiment(
    spec: TrialSpec, placement: Placement, send: Callable[[Report], None], progress: Callable[[], int]
) -> AbstractContextManager[Experiment]:
    """Connect the players of a trial.

    Args:
        spec: the trial.
        placement: of its players.
        send: receives reports about players that are not in this process; may be called from any thread.
        progress: returns the number of finished episodes, to detect a player that is killed repeatedly
            without progress; may be called from any thread.

    Raises:
        ConfigError: a name, an option or an address is wrong, or an address is in use.
        ExperimentError: a child process cannot be started, or no player is named for a role that is inside.
    """
    if placement.in_process:
        players = players_inside(spec, placement)
        agent, environment = players[Role.AGENT], players[Role.ENVIRONMENT]
        return local(agent, environment, pace=spec.pace, clock=time.perf_counter)
    from experiment_runner.executors.over_hub import over_hub  # slow to import

    return over_hub(spec, placement, send, progress)


def players_inside(spec: TrialSpec, placement: Placement) -> dict[Role, Any]:
    """Return the players that are objects in this process."""
    players = {}
    for role, player in ((Role.AGENT, spec.agent), (Role.ENVIRONMENT, spec.environment)):
        if role in placement.inside:
            if player is None:
                raise ExperimentError(f"name an {role}: none from outside can be inside the trial's process")
            players[role] = construct(find(role, player.name), player.options)
    if Role.ENVIRONMENT in players and not placement.any_reward:
        players[Role.ENVIRONMENT] = FiniteRewards(players[Role.ENVIRONMENT])
    if Role.ENVIRONMENT in players and placement.check_actions:
        players[Role.ENVIRONMENT] = CheckedActions(players[Role.ENVIRONMENT])
    return players
