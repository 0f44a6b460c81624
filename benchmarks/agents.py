"""The paper's agents in Infinite Mario, in one process: steps per second, and memory."""

from __future__ import annotations

import multiprocessing
import resource
import time
from collections.abc import Callable

from agents.mohan2010.flat import ObjectsFlatAgent, TilesAgent, TilesCoarseAgent
from agents.mohan2010.hierarchical import HierarchicalAgent, HierarchicalInternalAgent, ObjectsCoarseAgent
from benchmarks.measure import Table, count, medians, ratio
from env_server.mario.environment import InfiniteMario
from glue.engine.experiment import Experiment
from glue.engine.local import local
from glue.roles import Agent
from glue.types import Observation

_AGENTS: tuple[type[TilesAgent | HierarchicalAgent], ...] = (
    HierarchicalAgent,
    HierarchicalInternalAgent,
    ObjectsCoarseAgent,
    TilesAgent,
    TilesCoarseAgent,
    ObjectsFlatAgent,
)
_WARM_UP = 100
_EPISODES = 100
_TRIAL = 5000
_PARTS = 5


def run() -> list[Table]:
    """Measure everything about the agents."""
    return [_steps(), _trial()]


def _steps() -> Table:
    measures: list[Callable[[], float]] = []
    for kind in _AGENTS:
        agent = kind(seed=1)
        measures += [_together(agent), _alone(agent)]
    results = medians(measures)
    rows = [
        (kind.name, count(together), count(alone), ratio(together / 15_000))
        for kind, together, alone in zip(_AGENTS, results[::2], results[1::2], strict=True)
    ]
    return Table(
        "Agents",
        f"The paper's agents through `glue.local` on one core, after {_WARM_UP} episodes; and each alone, "
        "stepped over the observations of an episode. The aim is 15,000 steps per second.",
        ("agent", "with Infinite Mario, per second", "alone, per second", "times the aim"),
        rows,
    )


def _together(agent: Agent) -> Callable[[], float]:
    glue = local(agent, InfiniteMario())
    glue.rl_init(seed=1)
    _play(glue, _WARM_UP)

    def measure() -> float:
        began = time.perf_counter()
        steps = _play(glue, _EPISODES)
        return steps / (time.perf_counter() - began)

    return measure


def _play(glue: Experiment, episodes: int) -> int:
    """Play episodes; return the number of their steps."""
    steps = 0
    for _ in range(episodes):
        glue.rl_episode()
        steps += glue.rl_num_steps()
    return steps


def _alone(agent: Agent) -> Callable[[], float]:
    """Return a measure that steps a trained agent over one episode's observations, ignoring its actions."""
    seen: list[tuple[float, Observation]] = []

    def measure() -> float:
        if not seen:
            _record(agent, seen)
        began = time.perf_counter()
        for _ in range(_EPISODES):
            agent.agent_start(seen[0][1])
            for reward, observation in seen:
                agent.agent_step(reward, observation)
            agent.agent_end(0.0)
        return _EPISODES * len(seen) / (time.perf_counter() - began)

    return measure


def _record(agent: Agent, seen: list[tuple[float, Observation]]) -> None:
    """Play an episode with the agent; fill in its rewards and observations."""
    environment = InfiniteMario()
    environment.env_init()
    action = agent.agent_start(environment.env_start())
    terminal = False
    while not terminal:
        reward, observation, terminal, *_ = environment.env_step(action)
        seen.append((reward, observation))
        action = agent.agent_step(reward, observation)


def _trial() -> Table:
    """Run a trial in a process of its own, to measure only its memory."""
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        parts = pool.apply(_run_trial)
    rows = [
        (f"{(part + 1) * _TRIAL // _PARTS:,}", f"{seconds:.1f}", values, f"{megabytes:.0f}")
        for part, (seconds, values, megabytes) in enumerate(parts)
    ]
    return Table(
        "A trial of the paper",
        f"`hierarchical`, {_TRIAL:,} episodes in one process: seconds since its beginning (the aim is 90), "
        "values learned, and the peak of the process's memory, flat once the table grows no more.",
        ("episodes", "seconds", "values", "MB"),
        rows,
    )


def _run_trial() -> list[tuple[float, str, float]]:
    parts = []
    with local(HierarchicalAgent(), InfiniteMario()) as glue:
        glue.rl_init(seed=1)
        _play(glue, 1)  # Compiling, or reading from disk, is not part of the trial.
        glue.rl_init(seed=1)
        began = time.perf_counter()
        for _ in range(_PARTS):
            _play(glue, _TRIAL // _PARTS)
            peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
            parts.append((time.perf_counter() - began, glue.rl_agent_message("values"), peak))
    return parts
