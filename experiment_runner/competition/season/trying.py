"""The tasks as a season tells them, for trying an agent at home: without its secret levels.

It is not trusted there: only environments that are installed, by their names, are played.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any, Final

import msgspec

from experiment_runner.competition.settings import Competition
from glue.console import one_line
from glue.errors import ExperimentError
from glue.plugins.loading import names
from glue.wire.messages import Role

_TOLD: Final = ("name", "trials", "limits", "tasks")
_OTHERS: Final = ("episodes", "steps", "max_steps", "rate", "late")
_LEVELS: Final = ("level_seed", "mdp")
"""Options that name a level, which a hidden task does not tell."""


def tasks_of(competition: Competition) -> Mapping[str, Any]:
    """Return the public part of the tasks of a season, for JSON."""
    tasks = []
    for task in competition.proving:
        left_out = _LEVELS if task.hidden else ()
        options = {name: value for name, value in task.options.items() if name not in left_out}
        others = {one: getattr(task, one) for one in _OTHERS if getattr(task, one)}
        # A path of the organiser's machine says nothing elsewhere.
        tasks.append({"name": task.name, "env": Path(task.env).name, "options": options, **others})
    limits = asdict(competition.limits)
    return {"name": competition.name, "trials": competition.trials, "limits": limits, "tasks": tasks}


def competition_of(told: Mapping[str, Any]) -> Competition:
    """Return the competition that `tasks_of` tells of.

    Raises:
        ExperimentError: it is something else, perhaps of a newer version; or an environment is missing here.
    """
    try:
        competition = msgspec.convert({name: told.get(name) for name in _TOLD}, Competition)
    except msgspec.ValidationError as error:
        why = one_line(str(error), 200)
        raise ExperimentError(f"the season tells of its tasks in another form, is it newer? {why}") from None
    installed = names(Role.ENVIRONMENT)
    for task in competition.tasks:
        if task.env not in installed:
            raise ExperimentError(
                f"the environment {one_line(task.env, 80)} is not installed here: install its package; the "
                "organiser knows which"
            )
    return competition
