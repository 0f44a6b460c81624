"""The environment of a trial, in the hub's own process, where every step is recorded.

To the hub it is a peer like any other, but no socket leads to it: nobody can pose as it, and what is secret
about the level never leaves this process. It is asked for steps and nothing else: no message of the agent or
of anybody else reaches it.
"""

from __future__ import annotations

import math
import secrets
import time
from contextlib import suppress
from typing import Any, Final

from experiment_runner.competition.records.record import End, PartWriter
from glue.client.bodies import READ, write
from glue.core.calls import name_of, role_calls
from glue.core.sessions import INSTANCE_SIZE
from glue.errors import GlueError, PeerFailed, TaskSpecError
from glue.hub.server import Hub
from glue.protocol.messages import CALLS, PROTOCOL_VERSION, ErrorCode, Kind, Message, Role
from glue.protocol.wire import clip
from glue.roles import capabilities
from glue.taskspec import Space, parse_task_spec
from glue.types import CUT_OFF, Action

__all__ = ["InsideEnvironment"]

_TRUNCATE: Final = "truncate"
"""The one capability that its environment may have: agents are seeded, and saves are not taken."""

_ASKED: Final = frozenset({Kind.ENV_INIT, Kind.ENV_START, Kind.ENV_STEP, Kind.ENV_CLEANUP})


class InsideEnvironment:
    """An environment that takes part in a session of a hub in this process; a route of its switchboard.

    Args:
        hub: the hub, not yet running.
        session: the session's name.
        environment: the environment, seeded if it can be.
        record: takes the steps.

    Attributes:
        refusal: why the environment refused the agent's last action; None if it did not.
        failure: the environment's own error; None if it made none.
        steps: how many were carried out.
        in_episode: whether an episode has begun that the environment has not ended.
        cut_off: whether it has cut off the episode that it ended last.

    Raises:
        PeerFailed: a method of the role is missing.
    """

    def __init__(self, hub: Hub, session: str, environment: Any, record: PartWriter) -> None:
        self.refusal: str | None = None
        self.failure: str | None = None
        self.steps = 0
        self.in_episode = False
        self.cut_off = False
        self._hub = hub
        self._record = record
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

    def admits(self, role: Role, session: str) -> bool:
        """Return True: it is the hub's process that takes the role."""
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
            if kind is Kind.ENV_STEP and self._blames_agent(body, error):
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
            self._record.step(body, reward)
            if terminal:
                self.cut_off = terminal == CUT_OFF
                self._record.end(End.CUT_OFF if self.cut_off else End.TERMINAL)
                self.in_episode = False
        elif kind is Kind.ENV_START:
            self.in_episode = True
        elif kind is Kind.ENV_INIT:
            with suppress(TaskSpecError):
                self._actions = parse_task_spec(result).actions
        return scalars, result

    def _blames_agent(self, body: bytes, error: Exception) -> bool:
        """Return whether a step failed for the action: it was illegal, or the environment refused it."""
        try:
            action = Action.from_body(body)
        except GlueError:
            return True
        if self._actions is not None and self._actions.check(action) is not None:
            return True
        # One without a cause is about what the environment returned.
        return isinstance(error, GlueError) and not (
            isinstance(error, PeerFailed) and error.__cause__ is None
        )

    def _answer(self, message: Message) -> None:
        self._hub.switchboard.receive(self, message, time.monotonic())
