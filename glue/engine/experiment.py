"""The experiment's side of RL-Glue: its verbs, in one process or over a hub.

`glue.local` and `glue.connect` both return an `Experiment`, so that the same program
runs in one process or in three.
"""

from __future__ import annotations

import operator
from collections.abc import Iterator
from typing import Any, NamedTuple, TypeVar

from glue.closing import Closing
from glue.engine.metrics import unpack_metrics
from glue.errors import LocalProtocolError
from glue.types import CUT_OFF, Action, Observation, Step
from glue.wire.messages import Kind, Value

_T = TypeVar("_T")


class Start(NamedTuple):
    """The result of RL_start: the first observation and action of an episode."""

    observation: Observation
    action: Action


class Experiment(Closing):
    """RL-Glue's verbs. docs/protocol-reference.md defines their meaning, including corner cases.

    Every verb may raise these errors.

    Raises:
        LocalProtocolError: an argument has the wrong type or is out of range; no call was made.
        PeerLost: a player was lost, in this verb or since the previous one; the episode is void. Start it
            again.
        PeerFailed: a player raised an exception or broke the protocol.
        HubClosed: the hub ended the session.
    """

    def _call(self, kind: Kind, scalars: tuple[Value, ...] = (), body: Any = None) -> tuple[Any, Any]:
        """Carry out a verb; return the scalars and the body of its reply."""
        raise NotImplementedError

    def close(self) -> None:
        """Leave, without RL_cleanup."""

    def steps_under_way(self) -> int | None:
        """Return RL_num_steps of an episode that another thread is playing; None if it is not known here."""
        return None

    def late_actions(self) -> int | None:
        """Return the number of late actions since the last start; see `glue.pace`.

        The action that a start or a step has just returned is late if this number has grown. It is None if
        the environment waits for its agent, or the hub does not tell.
        """
        return None

    def rl_init(self, seed: int | None = None) -> str:
        """Initialise the environment, then the agent; reset the counters. Return the task spec.

        `seed`, 0 to 2**63 - 1, is passed to every player with the capability `seed`, before its init; agent
        and environment receive different numbers derived from it.
        """
        if seed is not None:
            seed = _whole(seed, 63, "a seed")
        return _known(self._call(Kind.RL_INIT, (seed,))[1], str)

    def rl_start(self) -> Start:
        """Begin an episode; return the first observation and the agent's first action."""
        observation, action = self._call(Kind.RL_START)[1]
        return Start(observation, action)

    def rl_step(self) -> Step:
        """Execute the last action; return its result, with the agent's next action."""
        (reward, terminal), (observation, action) = self._call(Kind.RL_STEP)
        return Step(reward, observation, bool(terminal), terminal == CUT_OFF, action)

    def rl_episode(self, max_steps: int = 0) -> bool:
        """Run an episode; return True if it reached its end, False if it was truncated (cut off).

        An episode is cut off by `max_steps`, or by an environment with the capability `truncate`.

        `max_steps`, 0 to 2**32 - 1, limits RL_num_steps, which is 1 after the start: the environment
        makes at most `max_steps` - 1 steps. 0 means no limit.
        """
        (terminal,), _ = self._call(Kind.RL_EPISODE, (_whole(max_steps, 32, "a step limit"),))
        return bool(terminal) and terminal != CUT_OFF

    def rl_go_on(self, max_steps: int) -> bool | None:
        """Continue the episode under way until it ends or RL_num_steps is `max_steps`, 0 for no limit.

        After RL_start, repeated calls are `rl_episode` in parts, between which an experiment may do anything
        else.

        Returns:
            True if the episode reached its end, False if the environment cut it off, None if it continues.
        """
        for step in steps(self, max_steps):
            if step.terminal:
                return not step.truncated
        return None

    def rl_return(self) -> float:
        """Return the undiscounted sum of the rewards since the last start."""
        return float(self._call(Kind.RL_RETURN)[0][0])

    def rl_num_steps(self) -> int:
        """Return the number of observations that the agent has received since the last start, inclusive."""
        return int(self._call(Kind.RL_NUM_STEPS)[0][0])

    def rl_num_episodes(self) -> int:
        """Return the number of episodes that have reached their end since RL_init."""
        return int(self._call(Kind.RL_NUM_EPISODES)[0][0])

    def rl_agent_message(self, message: str) -> str:
        """Send a text to the agent and return its answer."""
        return _known(self._call(Kind.RL_AGENT_MESSAGE, (), _given(message, str))[1], str)

    def rl_env_message(self, message: str) -> str:
        """Send a text to the environment and return its answer."""
        return _known(self._call(Kind.RL_ENV_MESSAGE, (), _given(message, str))[1], str)

    def rl_cleanup(self) -> None:
        """Clean up the environment, then the agent; counters stay."""
        self._call(Kind.RL_CLEANUP)

    def rl_env_start(self) -> Observation:
        """Half of RL_start: begin an episode in the environment only."""
        return _known(self._call(Kind.RL_ENV_START)[1], Observation)

    def rl_env_step(self, action: Action) -> Step:
        """Half of RL_step: execute `action` in the environment only; the agent takes no part."""
        (reward, terminal), observation = self._call(Kind.RL_ENV_STEP, (), _given(action, Action))
        return Step(reward, observation, bool(terminal), terminal == CUT_OFF)

    def rl_agent_start(self, observation: Observation) -> Action:
        """Half of RL_start: begin an episode with the agent only."""
        return _known(self._call(Kind.RL_AGENT_START, (), _given(observation, Observation))[1], Action)

    def rl_agent_step(self, reward: float, observation: Observation) -> Action:
        """Half of RL_step: give the agent the outcome of its action; return its next action."""
        scalars, body = (float(reward),), _given(observation, Observation)
        return _known(self._call(Kind.RL_AGENT_STEP, scalars, body)[1], Action)

    def rl_agent_end(self, reward: float) -> None:
        """Half of RL_step: end the episode for the agent, with its last reward."""
        self._call(Kind.RL_AGENT_END, (float(reward),))

    def rl_agent_save(self) -> bytes:
        """Return everything that the agent's later episodes depend on (capability `save`)."""
        return bytes(self._call(Kind.RL_AGENT_SAVE)[1])

    def rl_agent_load(self, data: bytes) -> None:
        """Restore the agent from the result of `rl_agent_save`."""
        self._call(Kind.RL_AGENT_LOAD, (), _given(data, bytes))

    def rl_env_save(self) -> bytes:
        """Return everything that the environment's later episodes depend on (capability `save`)."""
        return bytes(self._call(Kind.RL_ENV_SAVE)[1])

    def rl_env_load(self, data: bytes) -> None:
        """Restore the environment from the result of `rl_env_save`."""
        self._call(Kind.RL_ENV_LOAD, (), _given(data, bytes))

    def rl_agent_metrics(self) -> dict[str, float]:
        """Return the agent's metrics by name (capability `metrics`); callable during an episode, too."""
        return unpack_metrics(self._call(Kind.RL_AGENT_METRICS)[1])


def steps(glue: Experiment, max_steps: int) -> Iterator[Step]:
    """Yield the further steps of an episode until it ends or RL_num_steps is `max_steps`, 0 for no limit."""
    number = glue.rl_num_steps()
    while max_steps == 0 or number < max_steps:
        step = glue.rl_step()
        yield step
        if step.terminal:
            return
        number += 1


def _whole(number: Any, bits: int, what: str) -> int:
    """Return `number`, which may be one of NumPy's, as an int."""
    try:
        whole = operator.index(number)
    except TypeError:
        raise LocalProtocolError(f"{what} must be a whole number, not {number!r:.80}") from None
    if not 0 <= whole < 2**bits:
        raise LocalProtocolError(f"{what} must be from 0 to 2^{bits} - 1, not {whole}")
    return whole


def _given(value: _T, kind: type[_T]) -> _T:
    if not isinstance(value, kind):
        raise LocalProtocolError(f"expected a value of type {kind.__name__}, not {value!r:.80}")
    return value


def _known(body: Any, kind: type[_T]) -> _T:
    assert isinstance(body, kind)
    return body
