"""Between an engine and its agent: an environment that does not wait.

To the engine, a `Pacer` is the agent: it is asked for an action, and answers. The agent itself is asked in
turn, one call at a time, and the pacer decides what the engine is answered, and when:

- With a rate, the first step is due when AGENT_START is answered, and each other one a period after the one
  before. The newest action is carried out. If the agent has not answered the observation before the step, the
  action is *late*: the last one is repeated, or a named one takes its place.
- The call of a late agent stays outstanding. Observations that come meanwhile replace each other, and their
  rewards are added up; the agent is given the result as soon as it has answered. Other calls wait for that
  answer, too, so that the agent is asked everything that it would be asked otherwise.
- A step is due at least half a period after the observation before it, even if that came late because of
  the environment or of the host: such a delay is not the agent's.
- With a delay of d steps, an action is carried out d steps later. The first action of an episode, or the
  named one, fills the gap.

No clock is read here, and nothing sent: a host, such as `glue.hub.session`, passes both in and out.
"""

from __future__ import annotations

from collections import deque
from typing import Any, Final

from glue.engine.engine import Instruction, Reply
from glue.errors import RemoteProtocolError, TaskSpecError
from glue.pace import Pace
from glue.taskspec import parse_task_spec
from glue.wire.messages import Kind

_STEP: Final = Kind.AGENT_STEP
_ACTING: Final = frozenset({Kind.AGENT_START, Kind.AGENT_STEP})
"""Calls that are answered with an action."""


class Pacer:
    """The agent of one engine, as the engine sees it.

    Args:
        pace: the pace, which is not the default.
        empty: the action that is carried out before an agent has chosen one, in the host's form.
        named: the action of `pace`, in the host's form; None for the last one.

    Attributes:
        asked: the call that the agent is carrying out; None if there is none.
        deadline: the time, in seconds of the host's clock, at which `due` is to be called, as the engine
            waits for an action; None if it does not, or waits for the agent.
        num_late: number of late actions since the last start, each counted when it is carried out.
    """

    def __init__(self, pace: Pace, empty: Any, named: Any) -> None:
        self.asked: Instruction | None = None
        self.deadline: float | None = None
        self.num_late: int = 0
        self._pace = pace
        self._period = 1 / pace.rate if pace.rate else 0.0
        self._named = named
        self._newest = empty
        self._fresh = False  # the newest action has not been carried out
        self._waiting: deque[Instruction] = deque()  # at most a step that the agent has not seen, and a call
        self._line: deque[tuple[Any, bool]] = deque()  # delayed actions, and whether they stand for late ones
        self._at = 0.0  # when the last step was due
        self._asked_at = 0.0
        self._latency = 0.0

    @property
    def bodies(self) -> tuple[Any, ...]:
        """The bodies that it keeps, for the account of the host's memory."""
        asked = None if self.asked is None else self.asked.body
        delayed = (action for action, _ in self._line)
        return (self._named, self._newest, asked, *(call.body for call in self._waiting), *delayed)

    def unfit(self, task_spec: str) -> str:
        """Return why the named action cannot be carried out in an environment; "" if it can."""
        action = self._pace.action
        if action is None:
            return ""
        try:
            wrong = parse_task_spec(task_spec).actions.check(action)
        except TaskSpecError:
            return ""
        return f"the action in place of late ones, {self._pace.late}, is illegal: {wrong}" if wrong else ""

    def call(self, instruction: Instruction, now: float) -> None:
        """Take a call that the engine makes to its agent; `next_call` is the agent's."""
        kind, scalars, body = instruction
        if kind is _STEP or kind is Kind.AGENT_END:
            if self._waiting:  # a step that the agent has not seen
                scalars = (self._waiting.pop().scalars[0] + scalars[0],)  # type: ignore[operator]
            if kind is _STEP and self._period:
                self.deadline = max(self._at + self._period, now + self._period / 2)
        elif kind is Kind.AGENT_START:
            self.num_late = 0
        self._waiting.append(Instruction(kind, scalars, body))

    def next_call(self, now: float, told: bool) -> Instruction | None:
        """Return a call that is now to be made to the agent, or None.

        Args:
            now: the time, in seconds.
            told: whether the agent is told its deadline and its latency (capability `pace`).
        """
        if self.asked is not None or not self._waiting:
            return None
        self.asked = call = self._waiting.popleft()
        self._asked_at = now
        if told and call.kind is _STEP and self._period:
            due = self._at + self._period if self.deadline is None else self.deadline
            return call._replace(scalars=(*call.scalars, max(0.0, due - now), self._latency))
        return call

    def answered(self, kind: Kind, scalars: tuple[Any, ...], body: Any, now: float) -> Reply | None:
        """Take the agent's answer; return the answer for the engine, None if that is not due yet.

        Raises:
            RemoteProtocolError: this is the answer to another call.
        """
        asked = self.asked
        assert asked is not None
        if kind is not asked.kind:
            raise RemoteProtocolError(f"{kind.name} was answered; {asked.kind.name} was asked")
        self.asked = None
        if kind is Kind.AGENT_START:
            self._newest, self._fresh, self._at = body, False, now
            self._line = deque([(body if self._named is None else self._named, False)] * self._pace.delay)
        elif kind is _STEP:
            self._newest, self._fresh = body, True
        if kind in _ACTING:
            self._latency = now - self._asked_at
        if kind is not _STEP:
            return scalars, body
        return None if self._period else (scalars, self._delayed(body, late=False))

    def due(self) -> Reply:
        """Return the answer for the engine, as the deadline has come."""
        assert self.deadline is not None
        self._at, self.deadline = self.deadline, None
        action = self._newest if self._fresh or self._named is None else self._named
        self._fresh = False
        return (), self._delayed(action, late=self.asked is not None)

    def reset(self) -> None:
        """Forget all calls: the episode is void, or the agent was lost."""
        self.asked = self.deadline = None
        self._waiting.clear()

    def _delayed(self, action: Any, late: bool) -> Any:
        self._line.append((action, late))
        action, late = self._line.popleft()
        self.num_late += late
        return action
