"""The smoke phase: before a competition every entrant plays a little, and its owner gets a report.

Entrants play the first task on the default level of its environment, which reveals nothing secret.
"""

from __future__ import annotations

from collections.abc import Callable
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
from experiment_runner.executors.local import LocalExecutor
from experiment_runner.store.database import reported
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
        directory: receives a folder for each entrant to send to its owner: report.txt and log.txt.
        say: shows a line for each entrant.

    Raises:
        ConfigError: the task has no such environment, or a wrong option.
        ExperimentError: another process checks entrants in the same directory.
        StorageError: a report cannot be written.
    """
    with reported(f"cannot write to {directory}"):
        directory.mkdir(parents=True, exist_ok=True)
        lock = RunLock(directory)
    try:
        return _check_entrants(competition, directory, say)
    finally:
        (directory / LOCK_FILE).unlink(missing_ok=True)
        lock.release()


def _check_entrants(competition: Competition, directory: Path, say: Callable[[str], None]) -> int:
    run = name_of_run(directory)
    failed = 0
    for entrant in competition.entrants:
        folder = directory / entrant.name
        log = folder / "log.txt"
        with reported(f"cannot write to {folder}"):
            folder.mkdir(parents=True, exist_ok=True)
            log.write_bytes(b"")
        episodes, problem = _try(competition, entrant, log, run)
        with reported(f"cannot write to {folder}"):
            (folder / "report.txt").write_text(_report(competition, entrant, episodes, problem, log), "utf-8")
        failed += problem is not None and entrant.key is None
        say(f"{entrant.name}: {problem or f'played {EPISODES} episodes'}; see {folder / 'report.txt'}")
    return failed


def _try(
    competition: Competition, entrant: Entrant, log: Path, run: str
) -> tuple[list[EpisodeResult], str | None]:
    """Return the episodes that an entrant has played, and why it could not play all of them."""
    if entrant.key is not None:
        return [], "not tried: it joins from elsewhere, with its key"
    spec = public_trial(competition, entrant.name, EPISODES, _MAX_STEPS)
    try:
        starter = starter_for(entrant)
        starter.check(entrant)
        starter.sweep(run)
    except (ConfigError, ExperimentError) as error:
        return [], str(error)
    episodes: list[EpisodeResult] = []
    problem = None
    with LocalExecutor(1, MODULE, REPORTS) as executor:
        executor.start(Match(spec, entrant, competition.limits, 0, log, run))
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


def _report(
    competition: Competition, entrant: Entrant, episodes: list[EpisodeResult], problem: str | None, log: Path
) -> str:
    task = competition.tasks[0]
    time = competition.limits.time
    lines = [
        f"{competition.name}: {entrant.name} ({entrant.player})",
        "",
        f"{EPISODES} episodes of the environment {task.env} with a public level: "
        + ("well" if problem is None else problem),
        "",
        *(
            f"episode {result.episode}: return {result.episode_return:.6g} in {result.steps} steps, "
            f"{1000 * result.wall_time / max(result.steps, 1):.2f} ms per step"
            for result in episodes
        ),
        "",
        f"Limits of each trial: {time.start_seconds:g} s to connect, and as much to initialise; "
        f"{time.step_seconds:g} s per answer, and a bank of {time.bank_seconds:g} s for longer ones; "
        f"{time.total_seconds:g} s in all.",
        "",
        f"The end of its log, which is in {log.name}:",
        *_tail(log),
    ]
    return "\n".join(lines) + "\n"


def _tail(log: Path) -> list[str]:
    with reported(f"cannot read {log}"), open_regular(log) as file:
        size = file.seek(0, 2)
        file.seek(max(0, size - _MAX_TAIL))
        text = file.read().decode("utf-8", "replace")
    return [f"    {line}" for line in text.splitlines()[-_LAST_LINES:]]
