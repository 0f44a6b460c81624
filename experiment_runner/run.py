"""Run what remains of a plan, trial by trial, into its store."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager

from experiment_runner.plan import TrialSpec
from experiment_runner.progress import Reporter
from experiment_runner.resume import Remaining
from experiment_runner.store import Checkpoint, EpisodeResult, Store
from experiment_runner.trial import BEGINNING, Recorder, Start, run_trial
from glue.errors import GlueError
from glue.experiment import Experiment

__all__ = ["Connect", "run_trials", "start_of"]

Connect = Callable[[TrialSpec], AbstractContextManager[Experiment]]
"""Brings the players of a trial together."""


class _StoreSink:
    """Puts a trial's results into the store, and then tells the reporter."""

    def __init__(self, store: Store, spec: TrialSpec, reporter: Reporter) -> None:
        self._store = store
        self._spec = spec
        self._reporter = reporter

    def record(self, result: EpisodeResult, checkpoint: Checkpoint | None) -> None:
        self._store.record(self._spec.id, result, checkpoint)
        self._reporter.episode(self._spec, result)

    def void(self, episode: int, why: str) -> None:
        self._store.record_void(self._spec.id, episode, why)
        self._reporter.say(f"episode {episode} is void: {why}")

    def event(self, kind: str, text: str) -> None:
        self._store.record_event(kind, text, self._spec.id)
        self._reporter.say(text)


def run_trials(
    store: Store,
    left: Sequence[Remaining],
    connect: Connect,
    reporter: Reporter,
    *,
    checkpoint_every: int,
    recorder: Recorder | None = None,
) -> int:
    """Run the trials that are left, one after the other; return how many failed.

    A trial that fails is recorded, with the reason, and the next one begins.

    Raises:
        ExperimentError: the store cannot be written.
    """
    specs = {record.spec.id: record.spec for record in store.trials()}
    failed = 0
    for trial in left:
        spec = specs[trial.trial_id]
        reporter.begin(spec, trial.after)
        try:
            with connect(spec) as glue:
                run_trial(
                    glue,
                    spec,
                    _StoreSink(store, spec, reporter),
                    start=start_of(store, trial),
                    checkpoint_every=checkpoint_every,
                    recorder=recorder,
                )
        except GlueError as error:
            store.record_failure(spec.id, str(error))
            reporter.say(f"Error: {error}")
            failed += 1
    return failed


def start_of(store: Store, trial: Remaining) -> Start:
    """Return where a trial goes on."""
    found = store.checkpoint(trial.trial_id) if trial.after else None
    return Start(*found) if found else BEGINNING
