"""Agent, environment and experiment in one process: the engine over plain function calls.

    from glue.engine.local import local

    with local(MyAgent(), MyEnvironment()) as glue:
        glue.rl_init(seed=1)
        while glue.rl_num_episodes() < 100:
            glue.rl_episode(max_steps=1000)

The results are the same as over a hub, without the sockets.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, Final

from glue.engine.calls import Answer, Handler, name_of, role_calls, skippable, unfit_for_batch, unsupported
from glue.engine.engine import Engine, Instruction
from glue.engine.experiment import Experiment
from glue.engine.pacer import Pacer
from glue.errors import LocalProtocolError, PeerFailed, Unsupported, described
from glue.pace import Pace
from glue.roles import AgentLike, EnvironmentLike, MaskAgent, capabilities, offers
from glue.types import CUT_OFF, Action, Observation
from glue.wire.messages import BESIDE, CALLS, MASK, Kind, Role, Value

_WAITING: Final = Pace()


def local(
    agent: AgentLike,
    environment: EnvironmentLike,
    *,
    pace: Pace = _WAITING,
    clock: Callable[[], float] | None = None,
) -> LocalExperiment:
    """Return an experiment with this agent and environment; call its verbs.

    Args:
        agent: the agent.
        environment: the environment.
        pace: of the environment. In one process nothing has to wait: the time that the agent takes is
            measured, the environment takes none, and between the steps no time passes.
        clock: returns seconds, to measure the agent's time; needed if the pace has a rate.

    Raises:
        LocalProtocolError: there is a rate and no clock.
        PeerFailed: a required method of the role is missing.
    """
    if pace.rate and clock is None:
        raise LocalProtocolError("a rate needs a clock: local(..., clock=time.monotonic)")
    return LocalExperiment(agent, environment, pace, clock)


class LocalExperiment(Experiment):
    """RL-Glue's verbs over function calls. Made by `local`."""

    def __init__(
        self,
        agent: AgentLike,
        environment: EnvironmentLike,
        pace: Pace = _WAITING,
        clock: Callable[[], float] | None = None,
    ) -> None:
        self._engine = Engine(Action())
        calls = role_calls(Role.AGENT, agent)
        self._agent_reads_masks = offers(agent, MaskAgent)
        read = {MASK} if self._agent_reads_masks else set()
        if BESIDE.intersection(capabilities(environment)) - read:  # not all that may come is for the agent
            for kind in (Kind.AGENT_START, Kind.AGENT_STEP):
                calls[kind] = self._trimming(calls[kind])
        self._paced = _PacedAgent(calls, pace, clock or (lambda: 0.0)) if pace else None
        if self._paced is not None:
            calls = {kind: partial(self._paced.call, kind) for kind in calls}
        self._handlers = calls | role_calls(Role.ENVIRONMENT, environment)
        offered = capabilities(environment), capabilities(agent)
        self._unfit = unfit_for_batch(*offered, name_of(agent), bool(pace))
        self._names = {Role.AGENT: name_of(agent), Role.ENVIRONMENT: name_of(environment)}

    def steps_under_way(self) -> int:
        return self._engine.num_steps

    def late_actions(self) -> int | None:
        return None if self._paced is None else self._paced.pacer.num_late

    def rl_init(self, seed: int | None = None) -> str:
        task_spec = super().rl_init(seed)
        if self._paced is not None and (why := self._paced.pacer.unfit(task_spec)):
            raise Unsupported(why)
        return task_spec

    def rl_agent_metrics(self) -> dict[str, float]:
        metrics: dict[str, float] = self._call(Kind.RL_AGENT_METRICS)[1]  # in one process they need no body
        return metrics

    def rl_go_on(self, max_steps: int) -> bool | None:
        (terminal,), _ = self._call(Kind.RL_EPISODE, (max_steps, True))
        return terminal != CUT_OFF if terminal else None

    def _call(self, kind: Kind, scalars: tuple[Value, ...] = (), body: Any = None) -> tuple[Any, Any]:
        if kind is Kind.RL_INIT and self._unfit:
            raise Unsupported(self._unfit)
        if type(body) is Observation:
            body = self._seen(body)
        engine = self._engine
        handlers = self._handlers
        call, scalars, body = engine.begin(kind, scalars, body)
        try:
            while call is not kind:
                handler = handlers.get(call)
                if handler is None:
                    call, scalars, body = self._without(call)
                else:
                    try:
                        scalars, body = handler(scalars, body)
                    except (KeyboardInterrupt, SystemExit):
                        raise
                    except BaseException as error:  # also asyncio.CancelledError and GeneratorExit
                        raise self._failure(call, error) from error
                    call, scalars, body = engine.resume(call, scalars, body)
        except BaseException:
            engine.abort()
            if self._paced is not None:
                self._paced.pacer.reset()
            raise
        return scalars, body

    def _seen(self, observation: Observation) -> Observation:
        """Return an observation as the agent sees it."""
        return observation.without(mask=not self._agent_reads_masks, extras=True)

    def _trimming(self, handler: Handler) -> Handler:
        return lambda scalars, observation: handler(scalars, self._seen(observation))

    def _without(self, kind: Kind) -> Instruction:
        """Skip a call that its player does not offer, or raise Unsupported."""
        if skippable(kind):
            return self._engine.resume(kind, (), None)
        role = CALLS[kind].callee
        assert role is not None
        raise Unsupported(unsupported(kind, role, self._names[role]))

    def _failure(self, kind: Kind, error: BaseException) -> PeerFailed:
        role = CALLS[kind].callee
        assert role is not None
        return PeerFailed(f"{role} {self._names[role]} raised in {kind.name.lower()}: {described(error)}")


class _PacedAgent:
    """An agent at a pace, in a time in which only its calls take any.

    Args:
        calls: the agent's.
        pace: the pace.
        clock: measures its time.
    """

    def __init__(self, calls: Mapping[Kind, Handler], pace: Pace, clock: Callable[[], float]) -> None:
        self.pacer = Pacer(pace, Action(), pace.action)
        self._calls = calls
        self._clock = clock
        self._now = 0.0
        self._ends = 0.0  # when the agent answers the call that it was made last
        self._answer: Answer = (), None

    def call(self, kind: Kind, scalars: tuple[Any, ...], body: Any) -> Answer:
        """Return the answer for the engine, as if the agent had been somewhere else."""
        pacer = self.pacer
        pacer.call(Instruction(kind, scalars, body), self._now)
        while True:
            call = pacer.next_call(self._now, told=True)
            if call is not None:
                began = self._clock()
                self._answer = self._calls[call.kind](call.scalars, call.body)
                self._ends = self._now + self._clock() - began
            asked, deadline = pacer.asked, pacer.deadline
            if deadline is not None and (asked is None or self._ends > deadline):
                self._now = deadline
                return pacer.due()
            assert asked is not None
            self._now = max(self._now, self._ends)
            due = pacer.answered(asked.kind, *self._answer, self._now)
            if due is not None:
                return due
