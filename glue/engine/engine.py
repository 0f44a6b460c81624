"""The RL-Glue state machine, without I/O.

An engine turns each verb of an experiment into calls to the environment and the agent, one at a time.
Its host (the hub over sockets, `glue.engine.local` over function calls) carries out each call and returns the
answer:

    engine.begin(Kind.RL_STEP)                  # returns a call for the environment
    engine.resume(Kind.ENV_STEP, (r, t), obs)   # returns a call for the agent
    engine.resume(Kind.AGENT_STEP, (), action)  # returns the experiment's reply: its kind is RL_STEP

Each verb is a generator that reads like RL-Glue's own RL_glue.c: it yields calls and returns the
reply. Bodies pass through untouched; the engine never looks into an observation or an action.

Its state is that of RL-Glue: the last action, the return and number of steps of the episode, and the number
of episodes. As in RL-Glue, an experiment may call any verb at any time, early, late or twice. While a call
is outstanding, only its answer is accepted.

Source: RL-Glue 3.04, RL_glue.c.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Mapping
from typing import Any, Final, NamedTuple

import numpy as np

from glue.errors import LocalProtocolError, PeerLost, RemoteProtocolError
from glue.types import CUT_OFF
from glue.wire.messages import CALLS, Kind, Role, Value

EPISODE_VERBS: Final = frozenset(
    {Kind.RL_STEP, Kind.RL_ENV_STEP, Kind.RL_AGENT_START, Kind.RL_AGENT_STEP, Kind.RL_AGENT_END}
)
"""Verbs that continue an episode, which is impossible once one of its players has been replaced."""

_INITIALISING: Final = frozenset({Kind.ENV_SEED, Kind.ENV_INIT, Kind.AGENT_SEED, Kind.AGENT_INIT})


class Instruction(NamedTuple):
    """The host's next action: to carry out a call or, if `kind` is a verb, to reply to the experiment."""

    kind: Kind
    scalars: tuple[Value, ...] = ()
    body: Any = b""


Reply = tuple[tuple[Any, ...], Any]
Verb = Generator[Instruction, Reply, Reply]

_NO_SCALARS: Final[tuple[Value, ...]] = ()
_ENV_STEP: Final = Kind.ENV_STEP
_AGENT_STEP: Final = Kind.AGENT_STEP
_instruction: Final = tuple.__new__
"""Constructor of a named tuple, at half the cost of calling its class."""

_ENV_START: Final = Instruction(Kind.ENV_START)


class Engine:
    """The RL-Glue state of one experiment.

    Args:
        empty_action: the action that RL_step executes before an agent has chosen one, in the host's form.

    Attributes:
        task_spec: result of the last env_init; None before the first.
        last_action: the action that the next RL_step executes.
        total_reward: undiscounted sum of the rewards since the last start.
        num_steps: 0 after init, 1 after start, one more with each step that did not end the episode.
        num_episodes: episodes that reached a terminal step, with agent_end called, since the last init.
        given: the body of the verb that is being carried out; None while idle.
        observation: the last observation of that verb; None while idle.
        asked: the outstanding call; None while idle.
        awaiting: the kind of `asked`.
        verb: the experiment's verb that is being carried out; None while idle.
    """

    def __init__(self, empty_action: Any) -> None:
        self.task_spec: Any = None
        self.last_action: Any = empty_action
        self.total_reward: float = 0.0
        self.num_steps: int = 0
        self.num_episodes: int = 0
        self.given: Any = None
        self.observation: Any = None
        self.asked: Instruction | None = None
        self.awaiting: Kind | None = None
        self.verb: Kind | None = None
        self._running: Verb | None = None
        self._seed: int | None = None
        self._started = False
        self._void: str | None = None
        self._uninitialised: set[Role] = set()

    def begin(self, verb: Kind, scalars: tuple[Value, ...] = _NO_SCALARS, body: Any = b"") -> Instruction:
        """Start a verb of the experiment; return the first call, or the reply if there is none.

        Raises:
            LocalProtocolError: an earlier verb is still being carried out, or `verb` is not a verb.
            PeerLost: the episode that `verb` would continue is void; start another.
        """
        if self._running is not None:
            assert self.verb is not None
            raise LocalProtocolError(
                f"{verb.name} was called while {self.verb.name} is still being carried out"
            )
        run = _VERBS.get(verb)
        if run is None:
            raise LocalProtocolError(f"{verb.name} is not a verb of an experiment")
        if self._void is not None and verb in EPISODE_VERBS:
            raise PeerLost(f"the episode is void: {self._void}; start another")
        self.verb = verb
        self.given = body
        self._running = running = run(self, scalars, body)
        try:
            instruction = next(running)
        except StopIteration as stop:
            return self._reply(stop.value)
        return self._asking(instruction)

    def resume(self, kind: Kind, scalars: tuple[Value, ...], body: Any) -> Instruction:
        """Take the answer to the outstanding call; return the next call, or the reply.

        Raises:
            RemoteProtocolError: this is the answer to another call.
        """
        if kind is not self.awaiting:
            raise RemoteProtocolError(
                f"{kind.name} was answered; "
                + (f"{self.awaiting.name} was asked" if self.awaiting else "nothing was asked")
            )
        assert self._running is not None
        try:
            instruction = self._running.send((scalars, body))
        except StopIteration as stop:
            return self._reply(stop.value)
        return self._asking(instruction)

    def _reply(self, reply: Reply) -> Instruction:
        verb = self.verb
        assert verb is not None
        self._running = self.asked = self.verb = self.awaiting = self.given = self.observation = None
        return _instruction(Instruction, (verb, *reply))

    def _asking(self, instruction: Instruction) -> Instruction:
        if self._uninitialised:
            instruction = self._initialised_first(instruction)
        self.asked = instruction
        self.awaiting = instruction[0]
        return instruction

    def abort(self) -> None:
        """Forget the verb that is being carried out, if any; counters stay as they are."""
        if self._running is not None:
            self._running.close()
        self._running = self.asked = self.verb = self.awaiting = self.given = self.observation = None

    @property
    def bodies(self) -> tuple[Any, ...]:
        """The bodies that the engine keeps, that of the outstanding call among them; None for none.

        The verbs keep no bodies in variables of their own, so that a host can account for the memory.
        """
        return self.task_spec, self.last_action, self.given, self.observation

    @property
    def in_episode(self) -> bool:
        """Whether an episode is under way, so that losing a player makes it void."""
        return self._started

    def void(self, reason: str) -> None:
        """Note that a player is gone: an episode under way cannot be continued."""
        if self._started:
            self._void = reason
            self._started = False

    def replace(self, role: Role) -> None:
        """Note that a player was replaced: the new one is initialised before any other call to it.

        If a call to it is outstanding, `asked` may be another call afterwards.
        """
        if self.task_spec is not None:
            self._uninitialised.add(role)
        if self.asked is not None:
            self.asked = self._initialised_first(self.asked)
            self.awaiting = self.asked.kind

    def _initialised_first(self, instruction: Instruction) -> Instruction:
        """Return `instruction` or, if its player was replaced, the first call that initialises it."""
        role = CALLS[instruction.kind].callee
        if role not in self._uninitialised or instruction.kind in _INITIALISING:
            return instruction
        assert self._running is not None
        self._running = self._bring_up(role, instruction, self._running)
        return next(self._running)

    def _bring_up(self, role: Role, instruction: Instruction, verb: Verb) -> Verb:
        """Initialise a new player as RL_init did the previous one, then continue from `instruction`."""
        if role is Role.AGENT:
            yield from self._init_agent()
        elif (yield from self._init_environment()):
            self._uninitialised.add(Role.AGENT)
        try:
            while True:
                reply = yield instruction
                instruction = verb.send(reply)
        except StopIteration as stop:
            outcome: Reply = stop.value
            return outcome

    # The verbs, in the order of RL-Glue's manual.

    def _init(self, scalars: tuple[Any, ...], _: Any) -> Verb:
        self._seed = scalars[0] if scalars else None
        self._void = None
        self._started = False
        yield from self._init_environment()
        yield from self._init_agent()
        self.total_reward = 0.0
        self.num_steps = 0
        self.num_episodes = 0
        return _NO_SCALARS, self.task_spec

    def _init_environment(self) -> Generator[Instruction, Reply, bool]:
        """Initialise the environment; return whether it has another task spec than the one before."""
        if self._seed is not None:
            yield Instruction(Kind.ENV_SEED, (role_seed(self._seed, Role.ENVIRONMENT),))
        _, task_spec = yield Instruction(Kind.ENV_INIT)
        differs: bool = task_spec != self.task_spec
        self.task_spec = task_spec
        self._uninitialised.discard(Role.ENVIRONMENT)
        return differs

    def _init_agent(self) -> Generator[Instruction, Reply, None]:
        if self._seed is not None:
            yield Instruction(Kind.AGENT_SEED, (role_seed(self._seed, Role.AGENT),))
        yield Instruction(Kind.AGENT_INIT, _NO_SCALARS, self.task_spec)
        self._uninitialised.discard(Role.AGENT)

    def _start(self, _: tuple[Any, ...], __: Any) -> Verb:
        _, self.observation = yield from self._env_start(_NO_SCALARS, None)
        _, self.last_action = yield Instruction(Kind.AGENT_START, _NO_SCALARS, self.observation)
        return _NO_SCALARS, (self.observation, self.last_action)

    def _step(self, _: tuple[Any, ...], __: Any) -> Verb:
        self._started = True
        scalars, self.observation = yield _instruction(
            Instruction, (_ENV_STEP, _NO_SCALARS, self.last_action)
        )
        reward, terminal = scalars
        self.total_reward += reward
        if terminal:
            self._started = False
        if terminal and terminal != CUT_OFF:
            yield Instruction(Kind.AGENT_END, (reward,))
            self.num_episodes += 1
        else:
            self.num_steps += 1
            _, self.last_action = yield _instruction(Instruction, (_AGENT_STEP, (reward,), self.observation))
        return scalars, (self.observation, self.last_action)

    def _episode(self, scalars: tuple[Any, ...], _: Any) -> Verb:
        """Start, then step to the end or to the limit; the loop is `_step`, inlined.

        A second scalar, which no message has, skips the start and continues the episode under way.
        """
        max_steps = scalars[0]
        if len(scalars) == 1:
            yield from self._start(_NO_SCALARS, None)
        while max_steps == 0 or self.num_steps < max_steps:
            (reward, terminal), self.observation = yield _instruction(
                Instruction, (_ENV_STEP, _NO_SCALARS, self.last_action)
            )
            self.total_reward += reward
            if terminal:
                self._started = False
                if terminal != CUT_OFF:
                    yield Instruction(Kind.AGENT_END, (reward,))
                    self.num_episodes += 1
                    return (True,), None
            self.num_steps += 1
            _, self.last_action = yield _instruction(Instruction, (_AGENT_STEP, (reward,), self.observation))
            if terminal:
                return (CUT_OFF,), None
        # Cut off: agent_end is not called and the episode is not counted.
        self._started = False
        return (False,), None

    def _cleanup(self, _: tuple[Any, ...], __: Any) -> Verb:
        self._started = False
        yield Instruction(Kind.ENV_CLEANUP)
        yield Instruction(Kind.AGENT_CLEANUP)
        return _NO_SCALARS, None

    # Half steps, for experiments that connect agent and environment themselves. They do not change the last
    # action: an RL_step after them executes the action of the last RL_start or RL_step.

    def _env_start(self, _: tuple[Any, ...], __: Any) -> Verb:
        self.total_reward = 0.0
        self.num_steps = 1
        self._started = True
        self._void = None
        return (yield _ENV_START)

    def _env_step(self, _: tuple[Any, ...], action: Any) -> Verb:
        self._started = True
        scalars, observation = yield Instruction(Kind.ENV_STEP, _NO_SCALARS, action)
        reward, terminal = scalars
        self.total_reward += reward
        if terminal:
            self._started = False
        if terminal and terminal != CUT_OFF:
            self.num_episodes += 1
        else:
            self.num_steps += 1
        return scalars, observation

    @staticmethod
    def _query(name: str) -> Callable[[Engine, tuple[Any, ...], Any], Verb]:
        def verb(engine: Engine, _: tuple[Any, ...], __: Any) -> Verb:
            return (getattr(engine, name),), None
            yield

        return verb

    @staticmethod
    def _forward(kind: Kind) -> Callable[[Engine, tuple[Any, ...], Any], Verb]:
        def verb(_: Engine, scalars: tuple[Any, ...], body: Any) -> Verb:
            return (yield _instruction(Instruction, (kind, scalars, body)))

        return verb


_VERBS: Final[Mapping[Kind, Callable[[Engine, tuple[Any, ...], Any], Verb]]] = {
    Kind.RL_INIT: Engine._init,
    Kind.RL_START: Engine._start,
    Kind.RL_STEP: Engine._step,
    Kind.RL_EPISODE: Engine._episode,
    Kind.RL_RETURN: Engine._query("total_reward"),
    Kind.RL_NUM_STEPS: Engine._query("num_steps"),
    Kind.RL_NUM_EPISODES: Engine._query("num_episodes"),
    Kind.RL_AGENT_MESSAGE: Engine._forward(Kind.AGENT_MESSAGE),
    Kind.RL_ENV_MESSAGE: Engine._forward(Kind.ENV_MESSAGE),
    Kind.RL_CLEANUP: Engine._cleanup,
    Kind.RL_ENV_START: Engine._env_start,
    Kind.RL_ENV_STEP: Engine._env_step,
    Kind.RL_AGENT_START: Engine._forward(Kind.AGENT_START),
    Kind.RL_AGENT_STEP: Engine._forward(Kind.AGENT_STEP),
    Kind.RL_AGENT_END: Engine._forward(Kind.AGENT_END),
    Kind.RL_AGENT_SAVE: Engine._forward(Kind.AGENT_SAVE),
    Kind.RL_AGENT_LOAD: Engine._forward(Kind.AGENT_LOAD),
    Kind.RL_ENV_SAVE: Engine._forward(Kind.ENV_SAVE),
    Kind.RL_ENV_LOAD: Engine._forward(Kind.ENV_LOAD),
    Kind.RL_AGENT_METRICS: Engine._forward(Kind.AGENT_METRICS),
}


def role_seed(seed: int, role: Role) -> int:
    """Return the seed of `role` in an experiment with this seed; 0 <= result < 2**63.

    The seeds of the roles differ, so that agent and environment never share a stream of random numbers.
    """
    spawn_key = {Role.ENVIRONMENT: 0, Role.AGENT: 1, Role.EXPERIMENT: 2}[role]
    words = np.random.SeedSequence(seed, spawn_key=(spawn_key,)).generate_state(1, np.uint64)
    return int(words[0] >> np.uint64(1))
