"""An environment and an agent that cost next to nothing, and the processes that serve them."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager

import numpy as np

from glue.client.players import serve_agent, serve_environment
from glue.roles import Agent, Environment
from glue.types import Action, Observation, Step

SIZES = {
    "one int": Observation(ints=(1,)),
    "Mario's (23 ints, 44 doubles, 352 chars)": Observation(
        ints=np.arange(23, dtype=np.int32), doubles=np.arange(44) / 44, chars=bytes(352)
    ),
}
MASKED = "one int, and a mask of 12 actions"
_ACTION = Action(ints=(1,))


class Walk(Environment):
    """Shows the same observation forever; an episode ends when its experiment cuts it off."""

    def __init__(self, observation: Observation) -> None:
        self._body = observation.body

    def env_init(self) -> str:
        return "benchmark"

    def env_start(self) -> Observation:
        return Observation.from_body(self._body)

    def env_step(self, action: Action) -> Step:
        return Step(1.0, Observation.from_body(self._body), False)

    def env_message(self, message: str) -> str:
        return message


class Still(Agent):
    """Does the same thing forever."""

    def agent_start(self, observation: Observation) -> Action:
        return _ACTION

    def agent_step(self, reward: float, observation: Observation) -> Action:
        return _ACTION

    def agent_message(self, message: str) -> str:
        return message


class Masked(Walk):
    """Shows its observation with a mask of 12 actions if the last message said so, and else without."""

    env_masks = True

    def __init__(self) -> None:
        self._with, self._without = (
            Observation(ints=(1,), mask=mask) for mask in ([True] * 11 + [False], None)
        )
        super().__init__(self._without)

    def env_init(self) -> str:
        return (
            "VERSION RL-Glue-3.0 PROBLEMTYPE continuing DISCOUNTFACTOR 1.0 OBSERVATIONS INTS (0 1) "
            "ACTIONS INTS (0 11) REWARDS (0 1) EXTRA masks"
        )

    def env_message(self, message: str) -> str:
        self._body = (self._with if message == "mask" else self._without).body
        return message


class Reading(Still):
    """Does the same thing forever, and is sent masks."""

    agent_masks = True


@contextmanager
def serving(
    role: str, size: str, url: str, sessions: range = range(1), variables: Mapping[str, str] = os.environ
) -> Iterator[int]:
    """Serve agents or environments of `sessions` from a process of their own; yield its id."""
    command = [sys.executable, "-m", "benchmarks.players", role, size, url]
    command += [str(sessions.start), str(sessions.stop)]
    process = subprocess.Popen(command, stderr=subprocess.DEVNULL, env=dict(variables))
    try:
        yield process.pid
    finally:
        process.terminate()
        process.wait()


def _main(role: str, size: str, url: str, start: str, stop: str) -> None:
    names = [str(number) for number in range(int(start), int(stop))]
    key, hub_key = os.environ.get("GLUE_KEY"), os.environ.get("GLUE_HUB_KEY")
    if role == "agent":
        still = Reading if size == MASKED else Still
        serve_agent({name: still() for name in names}, url, key=key, hub_key=hub_key)
    else:
        walks = {name: Masked() if size == MASKED else Walk(SIZES[size]) for name in names}
        serve_environment(walks, url, key=key, hub_key=hub_key)


if __name__ == "__main__":
    _main(*sys.argv[1:])
