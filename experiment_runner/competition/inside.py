"""The environment of a trial, in the hub's own process, where every step is recorded.

To the hub it is a peer like any other, but without a socket: no program can pose as it, and the secret level
never leaves this process. Only the calls of an episode reach it, and no message of an agent.
"""

from __future__ import annotations

import math
import secrets
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Any, Final

from experiment_runner.executors.recording import run_of
from experiment_runner.plan.plan import TrialSpec
from experiment_runner.store.records import EpisodeResult
from glue.client.bodies import READ, write
from glue.engine.calls import name_of, role_calls
from glue.errors import GlueError, LocalProtocolError, PeerFailed, TaskSpecError
from glue.hub.io.server import Hub
from glue.hub.sessions import INSTANCE_SIZE
from glue.roles import capabilities
from glue.taskspec import Space, parse_task_spec
from glue.trajectory import MAX_EPISODE, ActionWriter, Ending
from glue.types import CUT_OFF, Action
from glue.wire.codec import clip
from glue.wire.messages import CALLS, PROTOCOL_VERSION, ErrorCode, Kind, Message, Role

_TRUNCATE: Final = "truncate"
"""The only capability offered to the hub, which seeds only the agent, and takes no saves."""

_ASKED: Final = frozenset({Kind.ENV_INIT, Kind.ENV_START, Kind.ENV_STEP, Kind.ENV_CLEANUP})


_MOST_ACTIONS: Final = 4 * 2**30
"""Maximum bytes of all actions of a trial, which its record keeps on the organiser's disk."""


class _TooMuch(GlueError):
    """The agent's actions are more than a record can hold."""


class InsideEnvironment:
    """An environment that takes part in a session of a hub in this process; a channel of its sessions.

    Args:
        hub: the hub, not yet running.
        session: the session's name.
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
        in_episode: whether an episode has begun and not ended.

    Raises:
        PeerFailed: a method of the role is missing.
    """

    def __init__(
        self,
        hub: Hub,
        session: str,
        environment: Any,
        record: ActionWriter,
        spec: TrialSpec,
        ended: Callable[[EpisodeResult], None],
    ) -> None:
        self.refusal: str | None = None
        self.failure: str | None = None
        self.steps: int = 0
        self.episodes: int = 0
        self.in_episode: bool = False
        self._hub = hub
        self._record = record
        self._spec = spec
        self._ended = ended
        self._return = 0.0
        self._bytes = 0
        self._bytes_before = 0
        self._first_step = 0
        self._began = 0.0
        self._actions: Space | None = None
        calls = role_calls(Role.ENVIRONMENT, environment)
        self._handlers = {kind: handler for kind, handler in calls.items() if kind in _ASKED}
        offered = tuple(name for name in capabilities(environment) if name == _TRUNCATE)
        instance = secrets.token_bytes(INSTANCE_SIZE)
        scalars = (
            (PROTOCOL_VERSION,),
            str(Role.ENVIRONMENT),
            instance,
            name_of(environment),
            "inside",
            offered,
        )
        self._answer(Message(Kind.HELLO, session, 0, scalars))

    def end(self, how: Ending) -> None:
        """End the current episode, if there is one, in the record and in the results.

        Args:
            how: VOID if the entrant forfeits in the middle of it.
        """
        if not self.in_episode:
            return
        self.in_episode = False
        self._record.end(how)
        if how is not Ending.VOID:
            self.episodes += 1
            terminal = how is Ending.TERMINAL
            # RL_num_steps counts observations, of which a terminal step has none.
            steps = self.steps - self._first_step + (not terminal)
            seconds = time.perf_counter() - self._began
            self._ended(EpisodeResult(self.episodes, self._return, steps, terminal, seconds))

    def admits(self, role: Role, session: str) -> bool:
        """Return True: the hub's own process takes the role."""
        return True

    def deliver(self, message: Message) -> bool:
        """Carry a call out, and answer it at once; the hub has nothing else to do until then."""
        kind, session, seq, _, body = message
        if kind not in CALLS:
            return True
        try:
            scalars, result = self._carry_out(kind, body)
        except Exception as error:
            why = str(error) if isinstance(error, GlueError) else f"{type(error).__name__}: {error}"
            if isinstance(error, _TooMuch) or (kind is Kind.ENV_STEP and self._blames_agent(body, error)):
                self.refusal = why
            else:
                self.failure = why
            self._answer(Message(Kind.ERROR, session, seq, (str(ErrorCode.EXCEPTION), clip(why))))
        else:
            self._answer(Message(kind, session, seq, scalars, write(result)))
        return True

    def _carry_out(self, kind: Kind, body: bytes) -> tuple[tuple[Any, ...], Any]:
        scalars, result = self._handlers[kind]((), READ[CALLS[kind].request.body](body))
        if kind is Kind.ENV_STEP:
            reward, terminal = scalars
            if not math.isfinite(reward):
                raise PeerFailed(f"the reward of a step is {reward}, not a finite number")
            self.steps += 1
            self._return += reward
            self._record_step(body, reward)
            if terminal:
                self.end(Ending.CUTOFF if terminal == CUT_OFF else Ending.TERMINAL)
        elif kind is Kind.ENV_START:
            self._record.start()
            self.in_episode = True
            self._return, self._first_step, self._bytes_before = 0.0, self.steps, self._bytes
            self._began = time.perf_counter()
        elif kind is Kind.ENV_INIT:
            self._record.run(run_of(self._spec, result))
            with suppress(TaskSpecError):
                self._actions = parse_task_spec(result).actions
        return scalars, result

    def _record_step(self, body: bytes, reward: float) -> None:
        self._bytes += len(body)
        if self._bytes > _MOST_ACTIONS:
            raise _TooMuch(f"its actions take more than {_MOST_ACTIONS >> 20} MiB in this trial")
        try:
            self._record.step(body, reward)
        except LocalProtocolError as error:  # a limit of the recording
            if self._bytes - self._bytes_before > MAX_EPISODE // 2:
                raise _TooMuch(f"its actions take more than {MAX_EPISODE >> 20} MiB in an episode") from None
            raise PeerFailed(str(error)) from None  # the environment pays too many different rewards

    def _blames_agent(self, body: bytes, error: Exception) -> bool:
        """Return whether a step failed because its action was illegal, or the environment refused it."""
        try:
            action = Action.from_body(body)
        except GlueError:
            return True
        if self._actions is not None and self._actions.check(action) is not None:
            return True
        # A PeerFailed without a cause is about the result of the environment.
        return isinstance(error, GlueError) and not (
            isinstance(error, PeerFailed) and error.__cause__ is None
        )

    def _answer(self, message: Message) -> None:
        self._hub.sessions.receive(self, message, time.monotonic())
