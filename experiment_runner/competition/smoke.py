"""The smoke phase: before a competition every entrant plays a little, and its owner gets a report.

Entrants play every task on the default level of its environment, which reveals nothing secret.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Final

from experiment_runner.competition.match import (
    MODULE,
    REPORTS,
    Forfeited,
    Match,
    starter_for,
)
from experiment_runner.competition.secret import public_trial
from experiment_runner.competition.settings import Competition, Entrant
from experiment_runner.competition.starting import name_of_run
from experiment_runner.executors.job import Ended, Lost, Recorded
from experiment_runner.executors.workers import LocalExecutor
from experiment_runner.store.database import reported
from experiment_runner.store.layout import write_flushed
from experiment_runner.store.lock import LOCK_FILE, RunLock
from experiment_runner.store.records import EpisodeResult
from glue.errors import ConfigError, ExperimentError
from glue.files import open_regular

EPISODES: Final = 3
_MAX_STEPS: Final = 1_000
_WAIT_SECONDS: Final = 0.2
_LAST_LINES: Final = 20
_MAX_TAIL: Final = 8192


def check_entrants(competition: Competition, directory: Path, say: Callable[[str], None]) -> int:
    """Let every entrant play, one after the other; return the number of those that could not.

    Args:
        competition: the competition.
        directory: receives a folder for each entrant to send to its owner: report.txt, and a log of each
            task.
        say: shows a line for each entrant.

    Raises:
        ConfigError: a task has no such environment, or a wrong option.
        ExperimentError: another process checks entrants in the same directory.
        StorageError: a report cannot be written.
    """
    with reported(f"cannot write to {directory}"):
        directory.mkdir(parents=True, exist_ok=True)
        lock = RunLock(directory)
    try:
        environments = [task.env for task in competition.tasks]
        with LocalExecutor(1, MODULE, REPORTS, warm=environments) as executor:
            return _check_entrants(competition, directory, say, executor)
    finally:
        (directory / LOCK_FILE).unlink(missing_ok=True)
        lock.release()


def _check_entrants(
    competition: Competition,
    directory: Path,
    say: Callable[[str], None],
    executor: LocalExecutor,
) -> int:
    run = name_of_run(directory)
    failed = 0
    for entrant in competition.entrants:
        folder = directory / entrant.name
        with reported(f"cannot write to {folder}"):
            folder.mkdir(parents=True, exist_ok=True)
        problem, lines = _checked(competition, entrant, folder, run, executor)
        with reported(f"cannot write to {folder}"):
            write_flushed(folder / "report.txt", "\n".join(lines) + "\n")
        failed += problem is not None and entrant.key is None
        result = problem or f"played {EPISODES} episodes of each task"
        say(f"{entrant.name}: {result}; see {folder / 'report.txt'}")
    return failed


def _checked(
    competition: Competition, entrant: Entrant, folder: Path, run: str, executor: LocalExecutor
) -> tuple[str | None, list[str]]:
    """Let an entrant play every task; return the first problem, if any, and the lines of its report."""
    time = competition.limits
    ends = (
        f"Limits of each trial: {time.start_seconds:g} s to connect, and as much to initialise; "
        f"{time.step_seconds:g} s per answer, and a bank of {time.bank_seconds:g} s for longer ones; "
        f"{time.total_seconds:g} s in all."
    )
    title = f"{competition.name}: {entrant.name} ({entrant.player})"
    problem: str | None
    if entrant.key is not None:
        problem = "not tried: it joins from elsewhere, with its key"
        return problem, [title, "", problem, "", ends]
    try:
        starter = starter_for(entrant)
        found = replace(entrant, id=starter.check(entrant, competition.limits))
        starter.sweep(run)
    except (ConfigError, ExperimentError) as error:
        return str(error), [title, "", str(error), "", ends]
    first, lines = None, [title, *([found.id] if found.id else []), ""]
    for task in competition.tasks:
        log = folder / f"{task.name}.log"
        with reported(f"cannot write to {log}"):
            write_flushed(log, "")
        most = min(task.max_steps or _MAX_STEPS, _MAX_STEPS)
        spec = public_trial(task, entrant.name, EPISODES, most)
        episodes, problem = _try(executor, Match(spec, found, competition.limits, 0, log, run))
        if first is None and problem is not None:
            first = f"task {task.name}: {problem}"
        lines += [
            f"task {task.name}, {EPISODES} episodes of the environment {task.env} with a public level: "
            + (problem or "all were played"),
            *(
                f"episode {result.episode}: return {result.episode_return:.6g} in {result.steps} steps, "
                f"{1000 * result.wall_time / max(result.steps, 1):.2f} ms per step"
                for result in episodes
            ),
            f"The end of its log, which is in {log.name}:",
            *_tail(log),
            "",
        ]
    return first, [*lines, ends]


def _try(executor: LocalExecutor, played: Match) -> tuple[list[EpisodeResult], str | None]:
    """Return the episodes that an entrant has played, and why it could not play all of them."""
    episodes: list[EpisodeResult] = []
    problem = None
    executor.start(played)
    while True:
        for _, report in executor.receive(_WAIT_SECONDS):
            match report:
                case Recorded(result):
                    episodes.append(result)
                case Forfeited(reason):
                    problem = f"would have forfeited: {reason}"
                case Ended(failure):
                    return episodes, problem or failure
                case Lost(why):
                    return episodes, why


def _tail(log: Path) -> list[str]:
    with reported(f"cannot read {log}"), open_regular(log) as file:
        size = file.seek(0, 2)
        file.seek(max(0, size - _MAX_TAIL))
        text = file.read().decode("utf-8", "replace")
    return [f"    {line}" for line in text.splitlines()[-_LAST_LINES:]]
