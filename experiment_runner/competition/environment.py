"""The environment of a trial, in the hub's own process, where every step is recorded.

No program can pose as it, and the secret level never leaves this process. Only the calls of an episode reach
it, no message of an agent and no save.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Final

from experiment_runner.competition.records.replay import recorded_run
from experiment_runner.plan.plan import TrialSpec
from experiment_runner.store.records import EpisodeResult
from glue.engine.calls import role_calls
from glue.errors import GlueError, LocalProtocolError, PeerFailed, TaskSpecError
from glue.roles import Environment, EnvironmentLike
from glue.taskspec import Space, parse_task_spec
from glue.trajectory import MAX_EPISODE, ActionWriter, Ending
from glue.types import CUT_OFF, Action, Observation, Step
from glue.wire.messages import Kind, Role

_MOST_ACTIONS: Final = 4 * 2**30
"""Maximum bytes of all actions of a trial, which its record keeps on the organiser's disk."""


class _TooMuch(GlueError):
    """The agent's actions are more than a record can hold."""


class RecordedEnvironment(Environment):
    """An environment whose episodes are recorded, and which knows who is to blame for an error.

    Args:
        environment: the environment, seeded if it can be.
        record: records the episodes.
        spec: the trial.
        ended: receives the result of each whole episode as soon as it is recorded, so that an agent that
            fails afterwards, in agent_end, changes neither.

    Attributes:
        refusal: why the environment refused the agent's last action; None if it did not.
        failure: the environment's own error; None if there was none.
        steps: number of steps carried out.
        episodes: number of episodes played to their end.
        num_late: returns the number of late actions in the current episode so far.

    Raises:
        PeerFailed: a method of the role is missing.
    """

    def __init__(
        self,
        environment: EnvironmentLike,
        record: ActionWriter,
        spec: TrialSpec,
        ended: Callable[[EpisodeResult], None],
    ) -> None:
        self.__wrapped__ = environment  # for its name
        self.refusal: str | None = None
        self.failure: str | None = None
        self.steps: int = 0
        self.episodes: int = 0
        self.num_late: Callable[[], int] = lambda: 0
        self._calls = role_calls(Role.ENVIRONMENT, environment)
        self._record = record
        self._spec = spec
        self._ended = ended
        self._in_episode = False
        self._return = 0.0
        self._late = 0
        self._bytes = 0
        self._bytes_before = 0
        self._first_step = 0
        self._began = 0.0
        self._actions: Space | None = None

    def env_init(self) -> str:
        """Initialise the environment, and begin the record."""
        with self._blaming():
            _, task_spec = self._calls[Kind.ENV_INIT]((), None)
            self._record.run(recorded_run(self._spec, task_spec))
            with suppress(TaskSpecError):
                self._actions = parse_task_spec(task_spec).actions
        return str(task_spec)

    def env_start(self) -> Observation:
        """Begin an episode, in the record too."""
        with self._blaming():
            _, observation = self._calls[Kind.ENV_START]((), None)
            self._record.start()
        self._in_episode = True
        self._return, self._late, self._first_step, self._bytes_before = 0.0, 0, self.steps, self._bytes
        self._began = time.perf_counter()
        assert isinstance(observation, Observation)
        return observation

    def env_step(self, action: Action) -> Step:
        """Carry out an action, and record it with its reward."""
        with self._blaming(action):
            (reward, terminal), observation = self._calls[Kind.ENV_STEP]((), action)
            if not math.isfinite(reward):
                raise PeerFailed(f"the reward of a step is {reward}, not a finite number")
            self.steps += 1
            self._return += reward
            self._record_step(action.body, reward)
        if terminal:
            self.end(Ending.CUTOFF if terminal == CUT_OFF else Ending.TERMINAL)
        return Step(reward, observation, bool(terminal), terminal == CUT_OFF)

    def env_cleanup(self) -> None:
        """Release what the environment has acquired."""
        self._calls[Kind.ENV_CLEANUP]((), None)

    def end(self, how: Ending) -> None:
        """End the current episode, if there is one, in the record and in the results.

        Args:
            how: VOID if the entrant forfeits in the middle of it.
        """
        if not self._in_episode:
            return
        self._in_episode = False
        self._record.end(how)
        if how is not Ending.VOID:
            self.episodes += 1
            terminal = how is Ending.TERMINAL
            # RL_num_steps counts observations, of which a terminal step has none.
            steps = self.steps - self._first_step + (not terminal)
            seconds = time.perf_counter() - self._began
            self._ended(EpisodeResult(self.episodes, self._return, steps, terminal, seconds, self._late))

    def _record_step(self, body: bytes, reward: float) -> None:
        self._bytes += len(body)
        if self._bytes > _MOST_ACTIONS:
            raise _TooMuch(f"its actions take more than {_MOST_ACTIONS >> 20} MiB in this trial")
        try:
            before, self._late = self._late, self.num_late()
            self._record.step(body, reward, late=self._late > before)
        except LocalProtocolError as error:  # a limit of the recording
            if self._bytes - self._bytes_before > MAX_EPISODE // 2:
                raise _TooMuch(f"its actions take more than {MAX_EPISODE >> 20} MiB in an episode") from None
            raise PeerFailed(str(error)) from None  # the environment pays too many different rewards

    @contextmanager
    def _blaming(self, action: Action | None = None) -> Iterator[None]:
        """Keep the reason of an error, which is a refusal of `action` or a failure of the environment."""
        try:
            yield
        except Exception as error:
            why = str(error) if isinstance(error, GlueError) else f"{type(error).__name__}: {error}"
            if action is not None and self._is_refusal(action, error):
                self.refusal = why
            else:
                self.failure = why
            raise PeerFailed(why) from error

    def _is_refusal(self, action: Action, error: Exception) -> bool:
        """Return whether a step failed because its action was illegal, or the environment refused it."""
        if self._actions is not None and self._actions.check(action) is not None:
            return True
        # A PeerFailed without a cause is about the result of the environment.
        return isinstance(error, GlueError) and not (
            isinstance(error, PeerFailed) and error.__cause__ is None
        )
