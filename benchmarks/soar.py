"""The agents on the Soar kernel in Infinite Mario, in one process: steps and decision cycles per second."""

from __future__ import annotations

import time
from collections.abc import Callable

from agents.soar.agents import (
    SoarFlatAgent,
    SoarHierarchicalAgent,
    SoarHierarchicalInternalAgent,
    SoarObjectsCoarseAgent,
)
from benchmarks.measure import Table, count, medians
from env_server.mario.environment import InfiniteMario
from glue.engine.local import local

_AGENTS = (
    SoarHierarchicalAgent,
    SoarHierarchicalInternalAgent,
    SoarObjectsCoarseAgent,
    SoarFlatAgent,
)
_WARM_UP = 20
_EPISODES = 5


def run() -> list[Table]:
    """Measure the Soar agents; an empty list without soar-sml."""
    try:
        import soar_sml  # noqa: F401 - only whether it is there
    except ImportError:
        return []
    measures = [_playing(kind) for kind in _AGENTS]
    rates = iter(medians([part for pair in measures for part in pair]))
    rows = [(kind.name, count(next(rates)), count(next(rates))) for kind in _AGENTS]
    return [
        Table(
            "Soar",
            f"The paper's agents as productions on the Soar kernel, with the game in the same process, after "
            f"{_WARM_UP} episodes. The aim is 400 steps per second for soar-hierarchical.",
            ("agent", "steps per second", "decision cycles per second"),
            rows,
        )
    ]


def _playing(kind: type[SoarHierarchicalAgent]) -> tuple[Callable[[], float], Callable[[], float]]:
    """Return two measures of an agent that has played some episodes: its steps and its decision cycles."""
    glue = local(kind(seed=1), InfiniteMario())
    glue.rl_init(seed=1)
    for _ in range(_WARM_UP):
        glue.rl_episode()

    def play() -> tuple[int, int, float]:
        cycles, steps, began = int(glue.rl_agent_message("cycles")), 0, time.process_time()
        for _ in range(_EPISODES):
            glue.rl_episode()
            steps += glue.rl_num_steps()
        return steps, int(glue.rl_agent_message("cycles")) - cycles, time.process_time() - began

    def steps() -> float:
        done, _, seconds = play()
        return done / seconds

    def cycles() -> float:
        _, done, seconds = play()
        return done / seconds

    return steps, cycles
