"""One trial: the players are connected, its episodes played, and every result is reported.

How the trial is played depends neither on where agent and environment run, nor on the use of the results.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Final

from experiment_runner.executors.interrupts import Interrupts
from experiment_runner.executors.job import (
    Ended,
    Happened,
    Job,
    Line,
    Playing,
    Recorded,
    Report,
    Start,
    Voided,
)
from experiment_runner.executors.players import open_experiment
from experiment_runner.executors.recording import Extras, Meter, Recorder
from experiment_runner.store.database import StorageError
from experiment_runner.store.records import (
    UNMETERED,
    Checkpoint,
    EndedEpisode,
    EpisodeResult,
    ask,
    measured,
)
from glue.console import show_failure
from glue.engine.experiment import Experiment
from glue.errors import (
    ConfigError,
    GlueError,
    HubUnreachable,
    PeerFailed,
    PeerLost,
    Refused,
    Unsupported,
    described,
)
from glue.trajectory import TrajectoryWriter

_LONG_SECONDS: Final = 5.0
"""Seconds after which it is reported that an episode has not ended."""

_PROGRESS_SECONDS: Final = 5.0


def run_job(
    job: Job,
    send: Callable[[Report], None],
    *,
    interrupts: Interrupts | None = None,
    recording: TrajectoryWriter | None = None,
) -> None:
    """Run a trial and send its reports, the last of which is `Ended`.

    Args:
        job: the trial to run.
        send: called with each report; calls never overlap.
        interrupts: lets the running episode end before Ctrl-C takes effect; None to not defer it.
        recording: receives every step; None for no recording.

    Raises:
        StorageError: from `send`, when a report cannot be stored.
        BrokenPipeError: from `send`, when its output is no longer read.
        ConfigError, HubUnreachable, Refused: the running hub for the players cannot be found, does not answer
            or does not admit this program. The trial has not failed: it can continue later.
    """
    lock = threading.Lock()  # the threads that watch players also report
    done = job.start.after

    def send_alone(report: Report) -> None:
        nonlocal done
        with lock:
            send(report)
        if isinstance(report, Recorded):
            done = report.result.episode

    failure = None
    try:
        with (
            open_experiment(job.spec, job.config.placement, send_alone, lambda: done) as glue,
            watched(glue, lambda: done, send_alone),
        ):
            Trial(glue, job, send_alone, interrupts or Interrupts(), recording).run()
    except (StorageError, BrokenPipeError, KeyboardInterrupt):
        raise
    except GlueError as error:
        if job.config.placement.hub.hub is not None and isinstance(
            error, ConfigError | HubUnreachable | Refused
        ):
            raise
        if isinstance(error, PeerFailed) and not isinstance(error.__cause__, GlueError | None):
            show_failure(error.__cause__)
        failure = described(error)
    except BaseException as error:
        show_failure(error)
        failure = described(error)
    send_alone(Ended(failure))


@contextmanager
def watched(
    glue: Experiment, done: Callable[[], int], send: Callable[[Report], None], seconds: float = _LONG_SECONDS
) -> Iterator[None]:
    """Report, as often as no episode has ended for so many seconds, how far the one under way is.

    Args:
        glue: plays in this thread.
        done: returns the number of finished episodes.
        send: called with each `Playing`, in another thread.
        seconds: between two looks.
    """
    over = threading.Event()

    def watch() -> None:
        before = done()
        while not over.wait(seconds):
            now, steps = done(), glue.steps_under_way()
            if now == before and steps != 0:  # 0: it is still being initialised
                with suppress(OSError, KeyboardInterrupt):  # the reports are no longer read
                    send(Playing(now + 1, steps))
            before = now

    watcher = threading.Thread(target=watch, name="watcher", daemon=True)
    watcher.start()
    try:
        yield
    finally:
        over.set()
        watcher.join()


class Trial:
    """The episodes of a trial after its start, until its number of episodes or of steps is reached.

    When a player is lost, the episode is void and is run again. If both players have the capability `save`,
    they are first restored from the newest checkpoint, or initialised, and repeat the episodes since then; so
    the results are those of a trial without the loss.

    Once all episodes are reported, the trial is finished, even if its cleanup fails.

    Args:
        glue: the connected experiment.
        job: the trial. If it does not accept any reward, an episode whose return is infinite or NaN ends it;
            single rewards are checked by `glue`, see `experiment_runner.executors.players`.
        send: called with each report.
        interrupts: lets the running episode end, followed by a checkpoint, before Ctrl-C takes effect.
        recording: receives every step, also of void episodes; None for no recording.
    """

    def __init__(
        self,
        glue: Experiment,
        job: Job,
        send: Callable[[Report], None],
        interrupts: Interrupts,
        recording: TrajectoryWriter | None,
    ) -> None:
        self._glue = glue
        self._spec, self._config, self._start = job
        self._send = send
        self._interrupts = interrupts
        config = job.config
        extras = Extras(config.extras, job.spec.environment_label) if config.extras else None
        self._meter = meter = Meter(glue, config.metrics, job.start, extras)
        self._recorder = None
        if recording is not None:
            self._recorder = Recorder(recording, job.spec, glue, meter, config.questions)
        self._play = (self._recorder or (meter if meter.each_step else glue)).rl_episode
        self._done = job.start.after
        self._steps = job.start.steps  # in the episodes done
        self._since: list[EpisodeResult] = []  # the episodes run after `start`, oldest first
        self._timed = False  # whether its results depend on a clock
        self._can_save: bool | None = None
        self._unsaved = ""  # the reason why no checkpoint can be taken
        self._warned: set[str] = set()  # texts of events that are reported once

    def run(self) -> None:
        """Run them.

        Raises:
            GlueError: the trial cannot continue. The results that were reported remain valid.
            KeyboardInterrupt: as `Interrupts.deferred`.
        """
        with self._interrupts.deferred():
            while not self._finished:
                try:
                    self._replay()
                    self._run_rest()
                except PeerLost as error:
                    self._send(Voided(self._done + 1, str(error)))
            self._clean_up()

    @property
    def _finished(self) -> bool:
        return self._spec.finished_by(self._done, self._steps)

    def _run_rest(self) -> None:
        """Run the remaining episodes, or until a player is lost whose state has to be restored.

        Raises:
            PeerLost: such a player was lost during an episode.
        """
        kept = True
        while kept and not self._finished:
            try:
                self._meter.begin()
                result = self._episode(self._done + 1, self._steps, self._play)
                answers = ask(self._glue, self._config.questions)
                played = Recorded(result, None, answers, self._meter.end(result))
            except PeerLost as error:
                if self._can_save:
                    raise
                # Players that cannot be restored continue as they are; the hub initialises new ones.
                self._send(Voided(self._done + 1, str(error)))
                self._report("replaced", "the lost player's learning is lost, too")
                continue
            for why in self._meter.missing():
                self._warn(UNMETERED, why)
            # Read only once, so that the trial never stops without taking a checkpoint.
            stopping = self._interrupts.requested
            kept = self._keep(played, stopping)
            if stopping:
                self._interrupts.check()

    def _clean_up(self) -> None:
        """Clean up; an error is recorded, but does not affect the results."""
        try:
            self._glue.rl_cleanup()
        except (GlueError, SystemExit) as error:
            self._report("cleanup", f"all episodes are stored, but cleaning up failed: {described(error)}")

    def _replay(self) -> None:
        """Bring both players to the current state of this trial."""
        task_spec = self._glue.rl_init(self._spec.seed)
        pace = self._spec.pace
        # A running hub's own pace may be one without a clock, which is not known here.
        self._timed = pace.rate > 0 if pace else self._glue.late_actions() is not None
        checkpoint = self._start.checkpoint
        if checkpoint is not None:
            self._glue.rl_env_load(checkpoint.environment)
            self._glue.rl_agent_load(checkpoint.agent)
        if self._can_save is None:
            self._can_save = self._save() is not None
        self._repeat()
        if self._recorder is not None:
            self._recorder.begin(task_spec, continued=checkpoint is not None or bool(self._since))

    def _repeat(self) -> None:
        """Repeat the episodes since the newest checkpoint, which restores the state of the players."""
        total = len(self._since)
        if total:
            where = (
                f"the checkpoint after episode {self._start.after}" if self._start.after else "the beginning"
            )
            self._send(Line(f"restoring the players: repeating {total} episodes since {where}"))
        shown = time.perf_counter()
        steps = self._start.steps
        for number, before in enumerate(self._since, 1):
            self._interrupts.check()
            again = self._episode(before.episode, steps, self._glue.rl_episode)
            steps += before.steps
            if not again.repeats(before):
                self._report("differs", f"episode {before.episode} had another result when repeated")
            if time.perf_counter() - shown >= _PROGRESS_SECONDS:
                shown = time.perf_counter()
                self._send(Line(f"repeated {number} of {total} episodes"))

    def _episode(self, number: int, steps: int, play: Callable[[int], bool]) -> EpisodeResult:
        """Play an episode that begins after `steps` steps of the trial."""
        began = time.perf_counter()
        terminal = play(self._spec.step_limit(steps))
        result = measured(number, EndedEpisode(self._glue, terminal, time.perf_counter() - began))
        if not (self._config.placement.any_reward or math.isfinite(result.episode_return)):
            raise GlueError(
                f"the return of episode {number} is {result.episode_return}: the environment gave a reward "
                "that is not a finite number (a run can be told to accept any reward)"
            )
        return result

    def _keep(self, played: Recorded, stopping: bool) -> bool:
        """Report an episode, with a checkpoint if one is due; return whether both players are still there."""
        result, checkpoint, lost, every = played.result, None, False, self._config.checkpoint_every
        self._steps += result.steps
        last = self._spec.finished_by(result.episode, self._steps)
        # What depends on a clock is not the same when it is repeated.
        due = every > 0 and (result.episode % every == 0 or self._timed)
        if not self._can_save:
            if due:
                why = f"no checkpoints: {self._unsaved}; should the run be interrupted, it starts over"
                self._warn("unsaved", why)
        elif due or last or stopping:
            try:
                checkpoint = self._save()
            except PeerLost as error:
                self._report("lost", str(error))
                lost = True
        self._send(played._replace(checkpoint=checkpoint))
        self._done = result.episode
        if checkpoint is None:
            if self._can_save:
                self._since.append(result)
        else:
            self._start = Start(result.episode, checkpoint, self._steps)
            self._since.clear()
        return not lost

    def _save(self) -> Checkpoint | None:
        try:
            environment = self._glue.rl_env_save()
            return Checkpoint(self._glue.rl_agent_save(), environment, self._meter.save())
        except Unsupported as error:
            self._unsaved = str(error)
            return None

    def _warn(self, kind: str, text: str) -> None:
        """Report an event, once in the trial."""
        if text not in self._warned:
            self._warned.add(text)
            self._report(kind, text)

    def _report(self, kind: str, text: str) -> None:
        self._send(Happened(kind, text))
