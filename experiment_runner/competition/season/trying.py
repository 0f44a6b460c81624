"""Try an agent at home, on the tasks of a season, as its server would play them.

The season tells what is played, without its secret levels: here they are drawn from a public seed. It is not
trusted: only environments that are installed here, by their names, are played.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, Final

import msgspec

from experiment_runner.competition.check import in_words, tried
from experiment_runner.competition.organiser import check, matches
from experiment_runner.competition.settings import Competition, Entrant
from experiment_runner.competition.starters import starter_for
from experiment_runner.competition.trials import trials
from experiment_runner.competition.worker import executor
from glue.console import one_line
from glue.errors import ExperimentError
from glue.plugins.loading import names
from glue.wire.messages import Role

_SEED: Final = b"at home"
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
    values = (competition.name, competition.trials, asdict(competition.limits), tasks)
    return dict(zip(_TOLD, values, strict=True))


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


def try_entrant(competition: Competition, entrant: Entrant, folder: Path, say: Callable[[str], None]) -> int:
    """Let an entrant play an attempt; return the number of trials that it would have forfeited.

    Args:
        competition: its tasks and limits.
        entrant: an image or a command.
        folder: for the logs.
        say: shows a line.

    Raises:
        ConfigError: the entrant cannot be started, or there is no such environment here.
    """
    found = replace(entrant, id=check(entrant, competition.limits))
    competition = replace(competition, entrants=(found,))
    made = matches(competition, trials(competition, _SEED), folder)
    starter_for(found).sweep(made[0].run)
    failed = 0
    with executor(1, competition.tasks) as workers:
        for match in made:
            episodes, used, problem = tried(workers, match)
            _, task, number = match.spec.id.parts
            steps = sum(episode.steps for episode in episodes)
            total = sum(episode.episode_return for episode in episodes)
            failed += problem is not None
            played = f"score {total:.10g} in {len(episodes)} episodes, {steps:,} steps"
            say(f"{task}, trial {number + 1} of {competition.trials}: {problem or played}")
            if used is not None:
                say(f"    {in_words(used, competition.limits)}")
            if problem is not None:
                say(f"    what it printed is in {match.log}")
    return failed
