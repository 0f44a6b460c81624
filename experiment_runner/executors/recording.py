"""Recording a trial: its episodes, step by step, in a file that `glue-replay` reads (docs/trajectories.md).

The file contains every episode that counts once, in order, and also those that became void because a player
was lost. Episodes that players only repeat to restore their state are not recorded.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

from experiment_runner.executors.metering import Meter
from experiment_runner.plan.plan import TrialSpec
from experiment_runner.store.records import ask
from glue.engine.engine import role_seed
from glue.engine.experiment import Experiment, steps
from glue.errors import PeerLost, Unsupported
from glue.trajectory import Run, TrajectoryError, TrajectoryReader, TrajectoryWriter
from glue.wire.messages import Role


@contextmanager
def recorded(path: Path | None) -> Iterator[TrajectoryWriter | None]:
    """Yield the writer of a new recording, or None without a path; remove the file if it has no episode.

    Raises:
        TrajectoryError: the file exists and contains episodes or anything else, or it cannot be written.
    """
    if path is None:
        yield None
        return
    _remove_remnant(path)  # left by a process that was killed, or had no disk space, before the first episode
    writer = TrajectoryWriter(path)
    try:
        with writer:
            yield writer
    finally:
        _remove_remnant(path)


def _remove_remnant(path: Path) -> None:
    """Remove a recording without an episode, and a file that is empty."""
    with suppress(TrajectoryError, OSError):
        if path.is_file() and (path.stat().st_size == 0 or next(iter(TrajectoryReader(path)), None) is None):
            path.unlink()


def run_of(spec: TrialSpec, task_spec: str, state: bytes = b"") -> Run:
    """Return the run with which the recording of a trial begins.

    Args:
        spec: the trial.
        task_spec: the environment's task spec.
        state: state that the environment has loaded; empty if none.
    """
    environment = spec.environment
    return Run(
        environment=environment.name if environment else "",
        options=environment.options if environment else {},
        task_spec=task_spec,
        seed=role_seed(spec.seed, Role.ENVIRONMENT),
        state=state,
    )


class Recorder:
    """Runner of a trial's episodes, like `Experiment.rl_episode`, which records every step.

    Args:
        writer: writes the recording; an episode is in the file once it has ended.
        spec: the trial.
        glue: the connected experiment.
        questions: messages to send to the agent at each start and after each step.
    """

    def __init__(
        self, writer: TrajectoryWriter, spec: TrialSpec, glue: Experiment, questions: Sequence[str] = ()
    ) -> None:
        self._writer = writer
        self._spec = spec
        self._glue = glue
        self._questions = questions
        self._answers: dict[str, str] = {}
        self._task_spec = ""
        self._goes_on = False
        self._in_run = False

    def begin(self, task_spec: str, goes_on: bool) -> None:
        """Begin a new run of the recording with the next episode.

        Args:
            task_spec: as `rl_init` returned it.
            goes_on: whether the environment has already run episodes or loaded a state since `rl_init`.
        """
        self._task_spec = task_spec
        self._goes_on = goes_on
        self._in_run = False

    def rl_episode(self, max_steps: int, meter: Meter | None = None) -> bool:
        """Run an episode; see `Experiment.rl_episode`.

        Args:
            max_steps: step limit.
            meter: reads the agent's metrics during the episode; None for none.

        Raises:
            PeerLost: a player was lost; the recording marks the episode as void.
            TrajectoryError: the recording cannot be written.
            LocalProtocolError: the episode exceeds the limits of a recording.
        """
        if not self._in_run:
            self._writer.run(run_of(self._spec, self._task_spec, self._saved() if self._goes_on else b""))
            self._in_run = True
        try:
            return self._episode(max_steps, meter)
        except PeerLost:
            self._writer.void()
            # The environment is a new one, or has executed a step whose result was not received.
            self.begin(self._task_spec, goes_on=True)
            raise

    def _saved(self) -> bytes:
        try:
            return self._glue.rl_env_save()
        except Unsupported:
            return b""

    def _episode(self, max_steps: int, meter: Meter | None) -> bool:
        observation, action = self._glue.rl_start()
        self._answers.clear()
        self._ask()
        self._writer.start(observation)
        for number, step in enumerate(steps(self._glue, max_steps), 1):
            self._ask()
            ended = step.terminal and not step.truncated
            self._writer.step(action, step.reward, step.observation, ended)
            if ended:
                return True
            if meter is not None:
                meter.after(number)
            action = step.action
        self._writer.cutoff()
        return False

    def _ask(self) -> None:
        """Record the agent's answers that differ from its previous ones in this episode."""
        for message, answer in ask(self._glue, self._questions):
            if self._answers.get(message) != answer:
                self._answers[message] = answer
                self._writer.answer(message, answer)
