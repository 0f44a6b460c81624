"""The sample agent: the original's actions, its generator, its memory."""

from __future__ import annotations

import gzip
import json
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from agents.mario.sample import SampleAgent
from env_server.mario.environment import InfiniteMario
from glue.types import Action

if TYPE_CHECKING:
    from tests.agents.conftest import Draw

GOLDEN = Path(__file__).parents[2] / "golden" / "sample_agent.jsonl.gz"


def runs() -> Iterator[tuple[dict[str, Any], list[list[list[int]]]]]:
    """Yield every recorded run and its actions, step by step, episode by episode."""
    run: dict[str, Any] = {}
    episodes: list[list[list[int]]] = []
    with gzip.open(GOLDEN, "rt") as lines:
        for line in map(json.loads, lines):
            if line["kind"] == "run":
                if run:
                    yield run, episodes
                run, episodes = line, []
            elif line["kind"] == "start":
                episodes.append([])
            elif line["kind"] == "step":
                episodes[-1].append(line["a"])
    yield run, episodes


def test_the_originals_actions_step_for_step() -> None:
    compared = 0
    for run, episodes in runs():
        agent = SampleAgent(seed=run["policy_seed"])
        agent.agent_seed(99)  # This must not override the seed given as an option.
        environment = InfiniteMario(
            level_seed=run["level_seed"],
            level_type=run["level_type"],
            level_difficulty=run["level_difficulty"],
        )
        agent.agent_init(environment.env_init())
        assert len(episodes) == 30
        for actions in episodes:
            action = agent.agent_start(environment.env_start())
            terminal = False
            for recorded in actions:
                assert not terminal
                assert action == Action(recorded)
                reward, observation, terminal, *_ = environment.env_step(action)
                if terminal:
                    agent.agent_end(reward)
                else:
                    action = agent.agent_step(reward, observation)
                compared += 1
            assert terminal
    assert compared == 15_490


def test_an_episode_that_was_cut_off_is_not_remembered(draw: Draw, task_spec: str) -> None:
    screen = draw("M", "7" * 21)
    agent = SampleAgent(seed=5)
    agent.agent_init(task_spec)
    first = [agent.agent_start(screen), *(agent.agent_step(0.0, screen) for _ in range(19))]
    agent.agent_end(0.0)
    for _ in range(3):
        agent.agent_start(screen)
    repeated = [agent.agent_start(screen), *(agent.agent_step(0.0, screen) for _ in range(12))]
    assert repeated == first[:13]
