"""One trial: a spec and an experiment's verbs to a stream of episode results.

It does not know whether agent and environment are in this process, in others, or on other machines;
nor what becomes of the results.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import NamedTuple, Protocol

from experiment_runner.plan import TrialSpec
from experiment_runner.recording import Recorder
from experiment_runner.store.records import Checkpoint, EpisodeResult
from glue.core.experiment import Experiment
from glue.errors import PeerLost, Unsupported

__all__ = ["BEGINNING", "Sink", "Start", "run_trial"]


class Sink(Protocol):
    """Where the results of a trial go. What is handed over is kept when the call returns."""

    def record(self, result: EpisodeResult, checkpoint: Checkpoint | None) -> None:
        """Take a finished episode, and what a later run can continue from after it."""
        ...

    def void(self, episode: int, why: str) -> None:
        """Take note that an attempt at an episode does not count."""
        ...

    def event(self, kind: str, text: str) -> None:
        """Take note of anything else that a reader of the results should know."""
        ...


class Start(NamedTuple):
    """Where a trial begins: after which episode, and with what its players had learned by then."""

    after: int = 0
    checkpoint: Checkpoint | None = None


BEGINNING = Start()


def run_trial(
    glue: Experiment,
    spec: TrialSpec,
    sink: Sink,
    *,
    start: Start = BEGINNING,
    checkpoint_every: int = 0,
    recorder: Recorder | None = None,
) -> None:
    """Run the episodes of `spec` that come after `start`.

    When a player is lost, its episode is void and is run again. If both players can save themselves
    (capability `save`), they are first brought back to the newest checkpoint, or the beginning, and repeat
    in silence what came since, so that the results are those of a trial without the loss.

    Args:
        glue: the verbs; connected.
        spec: what to run.
        sink: takes the results as they come.
        start: where to begin.
        checkpoint_every: episodes between checkpoints; 0 for none.
        recorder: writes down every step of the episodes that count, and of those that are void.

    Raises:
        GlueError: the trial cannot go on. What the sink was given stays true.
    """
    _Trial(glue, spec, sink, start, checkpoint_every, recorder).run()


class _Trial:
    def __init__(
        self,
        glue: Experiment,
        spec: TrialSpec,
        sink: Sink,
        start: Start,
        checkpoint_every: int,
        recorder: Recorder | None,
    ) -> None:
        self._glue = glue
        self._spec = spec
        self._sink = sink
        self._start = start
        self._every = checkpoint_every
        self._recorder = recorder
        self._play = glue.rl_episode if recorder is None else recorder.rl_episode
        self._done = start.after
        self._since: list[EpisodeResult] = []  # what was run after `start`, oldest first
        self._can_save: bool | None = None

    def run(self) -> None:
        ready = False
        while self._done < self._spec.episodes:
            try:
                if not ready:
                    self._make_ready()
                    ready = True
                result = self._episode(self._done + 1, self._play)
            except PeerLost as error:
                self._sink.void(self._done + 1, str(error))
                # Those who cannot be brought back go on as they are; the hub initialises newcomers.
                ready = ready and not self._can_save
                if ready:
                    self._sink.event("replaced", "what the lost player had learned is lost with it")
                continue
            ready = self._keep(result)
        self._glue.rl_cleanup()

    def _make_ready(self) -> None:
        """Bring both players to where this trial stands."""
        task_spec = self._glue.rl_init(self._spec.seed)
        checkpoint = self._start.checkpoint
        if checkpoint is not None:
            self._glue.rl_env_load(checkpoint.environment)
            self._glue.rl_agent_load(checkpoint.agent)
        if self._can_save is None:
            self._can_save = self._save() is not None
        for before in self._since:
            again = self._episode(before.episode, self._glue.rl_episode)
            if again[:4] != before[:4]:
                self._sink.event("differs", f"episode {before.episode} came out otherwise when repeated")
        if self._recorder is not None:
            self._recorder.begin(task_spec, goes_on=checkpoint is not None or bool(self._since))

    def _episode(self, number: int, play: Callable[[int], bool]) -> EpisodeResult:
        began = time.perf_counter()
        terminal = play(self._spec.max_steps)
        episode_return, steps = self._glue.rl_return(), self._glue.rl_num_steps()
        return EpisodeResult(number, episode_return, steps, terminal, time.perf_counter() - began)

    def _keep(self, result: EpisodeResult) -> bool:
        """Hand a result over, with a checkpoint if one is due; return whether the players are still there."""
        checkpoint, lost = None, False
        due = self._every > 0 and result.episode % self._every == 0
        if self._can_save and (due or result.episode == self._spec.episodes):
            try:
                checkpoint = self._save()
            except PeerLost as error:
                self._sink.event("lost", str(error))
                lost = True
        self._sink.record(result, checkpoint)
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
            self._sink.event("unsaved", f"{error}; interrupted, this trial starts over")
            return None
