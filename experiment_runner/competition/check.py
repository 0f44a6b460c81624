"""The check before a competition: every entrant plays a little, and its owner gets a report.

Entrants play every task on the default level of its environment, which reveals nothing secret. At home, their
owners can let them play a whole attempt.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Final

from experiment_runner.competition.launching import launcher_for, name_of_run
from experiment_runner.competition.match import Forfeited, Match, Used
from experiment_runner.competition.organiser import check, matches
from experiment_runner.competition.settings import Competition, Entrant, Limits
from experiment_runner.competition.trials import public_trial, trials
from experiment_runner.competition.worker import executor
from experiment_runner.executors.job import Ended, Lost, Recorded
from experiment_runner.executors.workers import LocalExecutor
from experiment_runner.store.database import reported
from experiment_runner.store.layout import LOCK_FILE, RunLock, write_flushed
from experiment_runner.store.records import EpisodeResult
from glue.errors import ConfigError, ExperimentError
from glue.files import open_regular

EPISODES: Final = 3
_MAX_STEPS: Final = 1_000
_WAIT_SECONDS: Final = 0.2
_AT_HOME: Final = b"at home"
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
    failed = 0
    try:
        with executor(1, competition.tasks) as workers:
            for entrant in competition.entrants:
                report = directory / entrant.name / "report.txt"
                problem, lines = _checked(competition, entrant, directory, workers)
                with reported(f"cannot write to {report.parent}"):
                    write_flushed(report, "\n".join(lines) + "\n")
                failed += problem is not None and entrant.key is None
                say(f"{entrant.name}: {problem or f'played {EPISODES} episodes of each task'}; see {report}")
    finally:
        (directory / LOCK_FILE).unlink(missing_ok=True)
        lock.release()
    return failed


def _checked(
    competition: Competition, entrant: Entrant, directory: Path, workers: LocalExecutor
) -> tuple[str | None, list[str]]:
    """Let an entrant play every task; return the first problem, if any, and the lines of its report."""
    limits, run = competition.limits, name_of_run(directory)
    lines = [f"{competition.name}: {entrant.name} ({entrant.player})"]
    ends = (
        f"Limits of each trial: {limits.start_seconds:g} s to connect, and as much to initialise; "
        f"{limits.step_seconds:g} s per answer, and a bank of {limits.bank_seconds:g} s for longer ones; "
        f"{limits.total_seconds:g} s in all."
    )
    try:
        if entrant.key is not None:
            raise ConfigError("not tried: it joins from elsewhere, with its key")
        launcher = launcher_for(entrant)
        found = replace(entrant, id=launcher.check(entrant, limits))
        launcher.sweep(run)
    except (ConfigError, ExperimentError) as error:
        return str(error), [*lines, "", str(error), "", ends]
    first = None
    lines += [*([found.id] if found.id else []), ""]
    for task in competition.tasks:
        log = directory / entrant.name / f"{task.name}.log"
        with reported(f"cannot write to {log}"):
            write_flushed(log, "")
        most = min(task.max_steps or _MAX_STEPS, _MAX_STEPS)
        spec = public_trial(task, entrant.name, EPISODES, most)
        episodes, used, problem = tried(workers, Match(spec, found, limits, 0, log, run))
        if first is None and problem is not None:
            first = f"task {task.name}: {problem}"
        lines += [
            f"task {task.name}, {EPISODES} episodes of the environment {task.env} with a public level"
            f"{task.pace}: " + (problem or "all were played"),
            *(
                f"episode {result.episode}: return {result.episode_return:.6g} in {result.steps} steps, "
                f"{1000 * result.wall_time / max(result.steps, 1):.2f} ms per step"
                + (f", {result.late:.0f} actions late" if task.rate else "")
                for result in episodes
            ),
            *([] if used is None else [in_words(used, limits)]),
            f"The end of its log, which is in {log.name}:",
            *_tail(log),
            "",
        ]
    return first, [*lines, ends]


def try_entrant(competition: Competition, entrant: Entrant, folder: Path, say: Callable[[str], None]) -> int:
    """Let an entrant play an attempt at home; return the number of trials that it would have forfeited.

    Its levels are drawn from a public seed.

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
    made = matches(competition, trials(competition, _AT_HOME), folder)
    launcher_for(found).sweep(made[0].run)
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


def tried(workers: LocalExecutor, played: Match) -> tuple[list[EpisodeResult], Used | None, str | None]:
    """Let an entrant play one match.

    Returns:
        The episodes that it has played, what it has used, and why it could not play all of them.
    """
    episodes: list[EpisodeResult] = []
    used = problem = None
    workers.start(played)
    while True:
        for _, report in workers.receive(_WAIT_SECONDS):
            match report:
                case Recorded(result):
                    episodes.append(result)
                case Forfeited(reason):
                    problem = f"would have forfeited: {reason}"
                case Used():
                    used = report
                case Ended(failure):
                    return episodes, used, problem or failure
                case Lost(why):
                    return episodes, used, why


def in_words(used: Used, limits: Limits) -> str:
    """Return the resource usage of an entrant as a line for its owner."""
    parts = []
    if used.processor is not None:
        parts.append(f"{used.processor:.2f} s of processors")
    if used.peak is not None:
        parts.append(f"{used.peak / 2**20:.0f} MiB of memory at most")
    if used.bank is not None:
        parts.append(f"time bank down to {used.bank:.2f} of {limits.bank_seconds:g} s")
    return "; ".join(parts)


def _tail(log: Path) -> list[str]:
    with reported(f"cannot read {log}"), open_regular(log) as file:
        size = file.seek(0, 2)
        file.seek(max(0, size - _MAX_TAIL))
        text = file.read().decode("utf-8", "replace")
    return [f"    {line}" for line in text.splitlines()[-_LAST_LINES:]]
