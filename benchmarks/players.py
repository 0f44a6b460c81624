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
        serve_agent({name: Still() for name in names}, url, key=key, hub_key=hub_key)
    else:
        serve_environment({name: Walk(SIZES[size]) for name in names}, url, key=key, hub_key=hub_key)


if __name__ == "__main__":
    _main(*sys.argv[1:])
