"""The sample agent: the original's actions, its generator, its memory."""

from __future__ import annotations

import gzip
import json
from pathlib import Path

from agents.mario.sample import SampleAgent
from env_server.mario.environment import InfiniteMario
from glue import Action, local
from tests.agents.screens import TASK_SPEC, draw

GOLDEN = Path(__file__).parents[2] / "golden" / "sample_agent.jsonl.gz"


def test_the_originals_actions_step_for_step() -> None:
    compared, terminal = 0, True
    with gzip.open(GOLDEN, "rt") as lines:
        for line in map(json.loads, lines):
            if line["kind"] == "run":
                agent = SampleAgent(seed=line["policy_seed"])
                agent.agent_seed(99)  # This must not override the seed given as an option.
                task = {name: line[name] for name in ("level_seed", "level_type", "level_difficulty")}
                glue = local(agent, InfiniteMario(**task))
                glue.rl_init()
            elif line["kind"] == "start":
                assert terminal
                action, terminal = glue.rl_start().action, False
            elif line["kind"] == "step":
                assert not terminal
                assert action == Action(line["a"])
                step = glue.rl_step()
                action, terminal = step.action, step.terminal
                compared += 1
    assert terminal
    assert compared == 15_490


def test_an_episode_that_was_cut_off_is_not_remembered() -> None:
    screen = draw("M", "7" * 21)
    agent = SampleAgent(seed=5)
    agent.agent_init(TASK_SPEC)
    first = [agent.agent_start(screen), *(agent.agent_step(0.0, screen) for _ in range(19))]
    agent.agent_end(0.0)
    for _ in range(3):
        agent.agent_start(screen)
    repeated = [agent.agent_start(screen), *(agent.agent_step(0.0, screen) for _ in range(12))]
    assert repeated == first[:13]
