"""One trial: from a spec and an experiment's verbs to a stream of episode results.

It does not depend on where agent and environment run, nor on what is done with the results.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from typing import Final, NamedTuple, Protocol

from experiment_runner.asking import Answer, ask
from experiment_runner.interrupts import Interrupts
from experiment_runner.plan import TrialSpec
from experiment_runner.recording import Recorder
from experiment_runner.store.records import Checkpoint, EpisodeResult
from glue.core.experiment import Experiment
from glue.errors import GlueError, PeerLost, Unsupported

__all__ = ["BEGINNING", "Sink", "Start", "run_trial"]


class Sink(Protocol):
    """Receives the results of a trial. What is given first is stored first."""

    def record(
        self, result: EpisodeResult, checkpoint: Checkpoint | None, answers: tuple[Answer, ...]
    ) -> None:
        """Store a finished episode, the checkpoint after it, if any, and what the agent answered after it;
        perhaps with the next ones."""
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
    """Where a trial starts: after which episode, and from which checkpoint."""

    after: int = 0
    checkpoint: Checkpoint | None = None


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
) -> None:
    """Run the episodes of `spec` after `start`.

    When a player is lost, the episode is void and is run again. If both players have the capability `save`,
    they are first restored from the newest checkpoint, or initialised, and repeat the episodes since then; so
    the results are those of a trial without the loss.

    Once all episodes are recorded, the trial is finished, even if its cleanup fails.

    Args:
        glue: the connected experiment.
        spec: the trial.
        sink: receives the results.
        start: where to start.
        checkpoint_every: episodes between checkpoints; 0 for none.
        recorder: records every step, also of void episodes; None for no recording.
        interrupts: lets the running episode end, followed by a checkpoint, before Ctrl-C takes effect; None
            to not defer it.
        any_reward: whether rewards may be infinite or NaN. If not, an episode whose return is infinite or NaN
            ends the trial; single rewards are checked by `glue`, see `experiment_runner.rewards`.
        questions: messages that the agent is sent after each episode.

    Raises:
        GlueError: the trial cannot continue. What the sink received remains valid.
        KeyboardInterrupt: as `Interrupts.deferred`.
    """
    interrupts = interrupts or Interrupts()
    _Trial(glue, spec, sink, start, checkpoint_every, recorder, interrupts, any_reward, questions).run()


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
        self._play = glue.rl_episode if recorder is None else recorder.rl_episode
        self._done = start.after
        self._since: list[EpisodeResult] = []  # the episodes run after `start`, oldest first
        self._can_save: bool | None = None
        self._unsaved = ""  # why no checkpoint can be taken
        self._warned = False

    def run(self) -> None:
        with self._interrupts.deferred():
            self._run_episodes()
            self._clean_up()

    def _run_episodes(self) -> None:
        ready = False
        while self._done < self._spec.episodes:
            try:
                if not ready:
                    self._make_ready()
                    ready = True
                result = self._episode(self._done + 1, self._play)
                answers = ask(self._glue, self._questions)
            except PeerLost as error:
                self._sink.void(self._done + 1, str(error))
                # Players that cannot be restored continue as they are; the hub initialises new ones.
                ready = ready and not self._can_save
                if ready:
                    self._sink.event("replaced", "what the lost player had learned is lost with it")
                continue
            # Read only once, so that the trial never stops without having taken a checkpoint.
            stopping = self._interrupts.requested
            ready = self._keep(result, answers, stopping)
            if stopping:
                self._interrupts.check()

    def _clean_up(self) -> None:
        """Clean up; an error is recorded, but does not affect the results."""
        try:
            self._glue.rl_cleanup()
        except (GlueError, SystemExit) as error:
            why = str(error) if isinstance(error, GlueError) else f"SystemExit: {error}"
            self._sink.event("cleanup", f"all episodes are stored, but cleaning up failed: {why}")

    def _make_ready(self) -> None:
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
        for number, before in enumerate(self._since, 1):
            self._interrupts.check()
            again = self._episode(before.episode, self._glue.rl_episode)
            if again[:4] != before[:4]:
                self._sink.event("differs", f"episode {before.episode} had another result when repeated")
            if time.perf_counter() - shown >= _PROGRESS_SECONDS:
                shown = time.perf_counter()
                self._sink.say(f"repeated {number} of {total} episodes")

    def _episode(self, number: int, play: Callable[[int], bool]) -> EpisodeResult:
        began = time.perf_counter()
        terminal = play(self._spec.max_steps)
        episode_return, steps = self._glue.rl_return(), self._glue.rl_num_steps()
        if not (self._any_reward or math.isfinite(episode_return)):
            raise GlueError(
                f"the return of episode {number} is {episode_return}: the environment gave a reward that is "
                "not a finite number (if the task means it, say --any-reward)"
            )
        return EpisodeResult(number, episode_return, steps, terminal, time.perf_counter() - began)

    def _keep(self, result: EpisodeResult, answers: tuple[Answer, ...], stopping: bool) -> bool:
        """Store a result, with a checkpoint if one is due; return whether both players are still there."""
        checkpoint, lost = None, False
        due = self._every > 0 and result.episode % self._every == 0
        if not self._can_save:
            if due:
                self._warn()
        elif due or result.episode == self._spec.episodes or stopping:
            try:
                checkpoint = self._save()
            except PeerLost as error:
                self._sink.event("lost", str(error))
                lost = True
        self._sink.record(result, checkpoint, answers)
        self._done = result.episode
        if checkpoint is None:
            if self._can_save:
                self._since.append(result)
        else:
            self._start = Start(result.episode, checkpoint)
            self._since.clear()
        return not lost

    def _save(self) -> Checkpoint | None:
        try:
            environment = self._glue.rl_env_save()
            return Checkpoint(self._glue.rl_agent_save(), environment)
        except Unsupported as error:
            self._unsaved = str(error)
            return None

    def _warn(self) -> None:
        """Warn, when the first checkpoint is due, that there is none."""
        if not self._warned:
            self._warned = True
            self._sink.event(
                "unsaved", f"no checkpoints: {self._unsaved}; should the run be interrupted, it starts over"
            )
