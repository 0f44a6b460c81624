"""Agent, environment and experiment in one process: the engine over plain function calls.

    from glue.engine.local import local

    with local(MyAgent(), MyEnvironment()) as glue:
        glue.rl_init(seed=1)
        while glue.rl_num_episodes() < 100:
            glue.rl_episode(max_steps=1000)

The results are the same as over a hub, without the sockets.
"""

from __future__ import annotations

from typing import Any

from glue.engine.calls import Handler, name_of, role_calls, skippable, unfit_for_batch, unsupported
from glue.engine.engine import Engine, Instruction
from glue.engine.experiment import Experiment
from glue.errors import PeerFailed, Unsupported, described
from glue.roles import AgentLike, EnvironmentLike, MaskAgent, capabilities, offers
from glue.types import CUT_OFF, Action, Observation
from glue.wire.messages import BESIDE, CALLS, Kind, Role, Value


def local(agent: AgentLike, environment: EnvironmentLike) -> LocalExperiment:
    """Return an experiment with this agent and environment; call its verbs.

    Raises:
        PeerFailed: a required method of the role is missing.
    """
    return LocalExperiment(agent, environment)


class LocalExperiment(Experiment):
    """RL-Glue's verbs over function calls. Made by `local`."""

    def __init__(self, agent: AgentLike, environment: EnvironmentLike) -> None:
        self._engine = Engine(Action())
        self._handlers = role_calls(Role.AGENT, agent) | role_calls(Role.ENVIRONMENT, environment)
        self._agent_reads_masks = offers(agent, MaskAgent)
        if not BESIDE.isdisjoint(capabilities(environment)):
            for kind in (Kind.AGENT_START, Kind.AGENT_STEP):
                self._handlers[kind] = self._trimming(self._handlers[kind])
        self._unfit = unfit_for_batch(capabilities(environment), capabilities(agent), name_of(agent))
        self._names = {Role.AGENT: name_of(agent), Role.ENVIRONMENT: name_of(environment)}

    def steps_under_way(self) -> int:
        return self._engine.num_steps

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
