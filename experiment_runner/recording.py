"""Recording a trial: its episodes, step by step, in a file that `glue-replay` reads (docs/trajectories.md).

The file contains every episode that counts once, in order, and also those that became void because a player
was lost. Episodes that players only repeat to restore their state are not recorded.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

from experiment_runner.asking import ask
from experiment_runner.plan import TrialSpec
from glue.core.engine import role_seed
from glue.core.experiment import Experiment
from glue.errors import PeerLost, Unsupported
from glue.protocol.messages import Role
from glue.trajectory import Run, TrajectoryError, TrajectoryReader, TrajectoryWriter
from glue.types import CUT_OFF

__all__ = ["Recorder", "recorded"]


@contextmanager
def recorded(path: Path | None) -> Iterator[TrajectoryWriter | None]:
    """Yield the writer of a new recording, or None without a path; remove the file if it has no episode.

    Raises:
        TrajectoryError: the file exists and contains episodes or anything else, or it cannot be written.
    """
    if path is None:
        yield None
        return
    _remove_remnant(path)  # of a process that was killed, or had no disk space, before the first episode
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


class Recorder:
    """Runs episodes of a trial like `Experiment.rl_episode`, and records every step.

    Args:
        writer: writes the recording; an episode is in the file once it has ended.
        spec: the trial.
        glue: the connected experiment.
        questions: messages that the agent is sent at each start and after each step.
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
            goes_on: whether the environment has run episodes or loaded a state since `rl_init`.
        """
        self._task_spec = task_spec
        self._goes_on = goes_on
        self._in_run = False

    def rl_episode(self, max_steps: int) -> bool:
        """Run an episode; see `Experiment.rl_episode`.

        Raises:
            PeerLost: a player was lost; the recording marks the episode as void.
            TrajectoryError: the recording cannot be written.
            LocalProtocolError: the episode exceeds the limits of a recording.
        """
        if not self._in_run:
            self._begin_run()
        try:
            return self._episode(max_steps)
        except PeerLost:
            self._writer.void()
            # The environment is a new one, or has executed a step whose result was not received.
            self.begin(self._task_spec, goes_on=True)
            raise

    def _begin_run(self) -> None:
        environment = self._spec.environment
        self._writer.run(
            Run(
                environment=environment.name if environment else "",
                options=environment.options if environment else {},
                task_spec=self._task_spec,
                seed=role_seed(self._spec.seed, Role.ENVIRONMENT),
                state=self._saved() if self._goes_on else b"",
            )
        )
        self._in_run = True

    def _saved(self) -> bytes:
        try:
            return self._glue.rl_env_save()
        except Unsupported:
            return b""

    def _episode(self, max_steps: int) -> bool:
        glue, writer = self._glue, self._writer
        observation, action = glue.rl_start()
        self._answers.clear()
        self._ask()
        writer.start(observation)
        num_steps = 1
        while max_steps == 0 or num_steps < max_steps:
            reward, observation, terminal, next_action = glue.rl_step()
            cut_off = terminal == CUT_OFF
            self._ask()
            writer.step(action, reward, observation, bool(terminal) and not cut_off)
            if cut_off:
                break
            if terminal:
                return True
            action = next_action
            num_steps += 1
        writer.cutoff()
        return False

    def _ask(self) -> None:
        """Note what the agent answers now, where it is not what it has answered before in this episode."""
        for message, answer in ask(self._glue, self._questions):
            if self._answers.get(message) != answer:
                self._answers[message] = answer
                self._writer.answer(message, answer)
