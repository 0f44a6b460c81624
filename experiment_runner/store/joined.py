"""The names of players that joined from outside, which a run records as events of kind `joined`.

A plan does not know these players, so a trial's id has `remote` in their place. Reports show their names.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Final

from experiment_runner.plan import REMOTE, TrialSpec
from experiment_runner.store.results import Results

__all__ = ["joined_player", "joined_players", "trial_name", "trial_names"]

_JOINED: Final = re.compile(r"(?P<role>agent|environment) (?P<name>.*?)( \([^()]*\))? joined")
"""An event of `experiment_runner.players`; the player's programming language is ignored."""


def joined_player(event: str) -> tuple[str, str] | None:
    """Return role and name of the player in the text of a `joined` event; None if it has none."""
    found = _JOINED.fullmatch(event)
    return found and (found["role"], found["name"])


def joined_players(run: Results) -> dict[tuple[str, str], str]:
    """Return the name of the last player that joined from outside, by trial and role.

    Raises:
        ExperimentError: the run cannot be read.
    """
    players = {}
    for event in run.events():
        if event.kind == "joined" and event.trial_id and (player := joined_player(event.text)):
            role, name = player
            players[event.trial_id, role] = name
    return players


def trial_name(spec: TrialSpec, joined: Mapping[tuple[str, str], str]) -> str:
    """Return a trial's id with the names of players from outside, as in `Jumper/mines/0`.

    Args:
        spec: the trial, as its plan has it.
        joined: the result of `joined_players`.
    """
    parts = spec.id.split("/")
    if spec.agent is None and parts[0] == REMOTE:
        parts[0] = joined.get((spec.id, "agent"), REMOTE)
    if spec.environment is None and parts[-2:-1] == [REMOTE]:
        parts[-2] = joined.get((spec.id, "environment"), REMOTE)
    return "/".join(parts)


def trial_names(run: Results) -> dict[str, str]:
    """Return the name of each trial by its id; see `trial_name`.

    Raises:
        ExperimentError: the run cannot be read.
    """
    joined = joined_players(run)
    return {trial.spec.id: trial_name(trial.spec, joined) for trial in run.trials()}
