"""One trial: from a spec and an experiment's verbs to a stream of episode results.

It does not depend on where agent and environment run, nor on the use of the results.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from typing import Final, NamedTuple, Protocol

from experiment_runner.executors.interrupts import Interrupts
from experiment_runner.executors.metering import Meter, play_metered
from experiment_runner.executors.recording import Recorder
from experiment_runner.plan.metrics import MetricsPlan
from experiment_runner.plan.plan import TrialSpec
from experiment_runner.store.records import (
    Answer,
    Checkpoint,
    EndedEpisode,
    EpisodeResult,
    Reading,
    ask,
    measured,
)
from glue.engine.experiment import Experiment
from glue.errors import GlueError, PeerLost, Unsupported


class Sink(Protocol):
    """Receiver of the results of a trial, which it stores in order."""

    def record(
        self,
        result: EpisodeResult,
        checkpoint: Checkpoint | None,
        answers: tuple[Answer, ...],
        metrics: tuple[Reading, ...],
    ) -> None:
        """Store a finished episode, with the checkpoint and the agent's answers after it, if any, and its
        metrics.

        The sink may hold an episode back, to store it together with later ones.
        """
        ...

    def void(self, episode: int, why: str) -> None:
        """Record that an attempt at an episode does not count."""
        ...

    def event(self, kind: str, text: str) -> None:
        """Record any other event that matters to the results."""
        ...

    def say(self, line: str) -> None:
        """Show a line to the user."""
        ...


class Start(NamedTuple):
    """The start of a trial: the episode after which it starts, the checkpoint, and the sums of the steps and
    of the returns until then.
    """

    after: int = 0
    checkpoint: Checkpoint | None = None
    steps: int = 0
    reward: float = 0.0


BEGINNING = Start()

_PROGRESS_SECONDS: Final = 5.0


def run_trial(
    glue: Experiment,
    spec: TrialSpec,
    sink: Sink,
    *,
    start: Start = BEGINNING,
    checkpoint_every: int = 0,
    recorder: Recorder | None = None,
    interrupts: Interrupts | None = None,
    any_reward: bool = False,
    questions: Sequence[str] = (),
    metrics: MetricsPlan | None = None,
) -> None:
    """Run the episodes of `spec` after `start`, until its number of episodes or of steps is reached.

    When a player is lost, the episode is void and is run again. If both players have the capability `save`,
    they are first restored from the newest checkpoint, or initialised, and repeat the episodes since then; so
    the results are those of a trial without the loss.

    Once all episodes are stored, the trial is finished, even if its cleanup fails.

    Args:
        glue: the connected experiment.
        spec: the trial.
        sink: receives the results.
        start: the episode and checkpoint to start from.
        checkpoint_every: episodes between checkpoints; 0 for none.
        recorder: records every step, also of void episodes; None for no recording.
        interrupts: lets the running episode end, followed by a checkpoint, before Ctrl-C takes effect; None
            to not defer it.
        any_reward: whether rewards may be infinite or NaN. If not, an episode whose return is infinite or NaN
            ends the trial; single rewards are checked by `glue`, see `experiment_runner.executors.rewards`.
        questions: messages to send to the agent after each episode.
        metrics: the agent's metrics to record; None for none.

    Raises:
        GlueError: the trial cannot continue. The results that the sink has received remain valid.
        KeyboardInterrupt: as `Interrupts.deferred`.
    """
    interrupts = interrupts or Interrupts()
    _Trial(
        glue, spec, sink, start, checkpoint_every, recorder, interrupts, any_reward, questions, metrics
    ).run()


class _Trial:
    def __init__(
        self,
        glue: Experiment,
        spec: TrialSpec,
        sink: Sink,
        start: Start,
        checkpoint_every: int,
        recorder: Recorder | None,
        interrupts: Interrupts,
        any_reward: bool,
        questions: Sequence[str],
        metrics: MetricsPlan | None,
    ) -> None:
        self._glue = glue
        self._spec = spec
        self._sink = sink
        self._start = start
        self._every = checkpoint_every
        self._recorder = recorder
        self._interrupts = interrupts
        self._any_reward = any_reward
        self._questions = questions
        saved = start.checkpoint.metrics if start.checkpoint else b""
        self._meter = None if metrics is None else Meter(glue, metrics, start.steps, start.reward, saved)
        self._done = start.after
        self._steps = start.steps  # in the episodes done
        self._since: list[EpisodeResult] = []  # the episodes run after `start`, oldest first
        self._can_save: bool | None = None
        self._unsaved = ""  # the reason why no checkpoint can be taken
        self._warned = False
        self._told = False  # whether the lack of metrics was reported

    def run(self) -> None:
        with self._interrupts.deferred():
            while not self._finished:
                try:
                    self._replay()
                    self._run_rest()
                except PeerLost as error:
                    self._void(error)
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
                if self._meter is not None:
                    self._meter.begin()
                result = self._episode(self._done + 1, self._steps, self._play)
                answers = ask(self._glue, self._questions)
                metrics = self._readings(result)
            except PeerLost as error:
                if self._can_save:
                    raise
                # Players that cannot be restored continue as they are; the hub initialises new ones.
                self._void(error)
                self._sink.event("replaced", "the lost player's learning is lost, too")
                continue
            # Read only once, so that the trial never stops without taking a checkpoint.
            stopping = self._interrupts.requested
            kept = self._keep(result, answers, metrics, stopping)
            if stopping:
                self._interrupts.check()

    def _play(self, max_steps: int) -> bool:
        """Run an episode that counts: recorded, with metrics, or neither."""
        meter = self._meter if self._meter is not None and self._meter.each_step else None
        if self._recorder is not None:
            return self._recorder.rl_episode(max_steps, meter)
        return (
            self._glue.rl_episode(max_steps) if meter is None else play_metered(self._glue, max_steps, meter)
        )

    def _readings(self, result: EpisodeResult) -> tuple[Reading, ...]:
        """Return the readings of an episode's metrics; say once if the agent has none."""
        if self._meter is None:
            return ()
        readings = self._meter.end(result)
        if self._meter.missing and not self._told:
            self._told = True
            self._sink.event("unmetered", f"no metrics are recorded: {self._meter.missing}")
        return readings

    def _void(self, error: PeerLost) -> None:
        self._sink.void(self._done + 1, str(error))

    def _clean_up(self) -> None:
        """Clean up; an error is recorded, but does not affect the results."""
        try:
            self._glue.rl_cleanup()
        except (GlueError, SystemExit) as error:
            why = str(error) if isinstance(error, GlueError) else f"SystemExit: {error}"
            self._sink.event("cleanup", f"all episodes are stored, but cleaning up failed: {why}")

    def _replay(self) -> None:
        """Bring both players to the current state of this trial."""
        task_spec = self._glue.rl_init(self._spec.seed)
        checkpoint = self._start.checkpoint
        if checkpoint is not None:
            self._glue.rl_env_load(checkpoint.environment)
            self._glue.rl_agent_load(checkpoint.agent)
        if self._can_save is None:
            self._can_save = self._save() is not None
        self._repeat()
        if self._recorder is not None:
            self._recorder.begin(task_spec, goes_on=checkpoint is not None or bool(self._since))

    def _repeat(self) -> None:
        """Repeat the episodes since the newest checkpoint, which restores the state of the players."""
        total = len(self._since)
        if total:
            where = (
                f"the checkpoint after episode {self._start.after}" if self._start.after else "the beginning"
            )
            self._sink.say(f"restoring the players: repeating {total} episodes since {where}")
        shown = time.perf_counter()
        steps = self._start.steps
        for number, before in enumerate(self._since, 1):
            self._interrupts.check()
            again = self._episode(before.episode, steps, self._glue.rl_episode)
            steps += before.steps
            if not again.repeats(before):
                self._sink.event("differs", f"episode {before.episode} had another result when repeated")
            if time.perf_counter() - shown >= _PROGRESS_SECONDS:
                shown = time.perf_counter()
                self._sink.say(f"repeated {number} of {total} episodes")

    def _episode(self, number: int, steps: int, play: Callable[[int], bool]) -> EpisodeResult:
        """Play an episode that begins after `steps` steps of the trial."""
        began = time.perf_counter()
        terminal = play(self._spec.step_limit(steps))
        result = measured(number, EndedEpisode(self._glue, terminal, time.perf_counter() - began))
        if not (self._any_reward or math.isfinite(result.episode_return)):
            raise GlueError(
                f"the return of episode {number} is {result.episode_return}: the environment gave a reward "
                "that is not a finite number (a run can be told to accept any reward)"
            )
        return result

    def _keep(
        self,
        result: EpisodeResult,
        answers: tuple[Answer, ...],
        metrics: tuple[Reading, ...],
        stopping: bool,
    ) -> bool:
        """Store a result, with a checkpoint if one is due; return whether both players are still there."""
        checkpoint, lost = None, False
        self._steps += result.steps
        last = self._spec.finished_by(result.episode, self._steps)
        due = self._every > 0 and result.episode % self._every == 0
        if not self._can_save:
            if due:
                self._warn()
        elif due or last or stopping:
            try:
                checkpoint = self._save()
            except PeerLost as error:
                self._sink.event("lost", str(error))
                lost = True
        self._sink.record(result, checkpoint, answers, metrics)
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
            metrics = b"" if self._meter is None else self._meter.save()
            return Checkpoint(self._glue.rl_agent_save(), environment, metrics)
        except Unsupported as error:
            self._unsaved = str(error)
            return None

    def _warn(self) -> None:
        """Warn, when the first checkpoint is due, that it cannot be taken."""
        if not self._warned:
            self._warned = True
            self._sink.event(
                "unsaved", f"no checkpoints: {self._unsaved}; should the run be interrupted, it starts over"
            )
