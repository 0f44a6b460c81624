"""`glue-agent NAME --load`: an agent that begins every run with the state saved by another run."""

from __future__ import annotations

import json
from contextlib import closing
from pathlib import Path

import pytest

from agents.mario.sample import SampleAgent
from agents.tabular import SarsaAgent
from env_server.toys import MinesEnvironment, SkeletonEnvironment
from glue.engine.calls import name_of
from glue.engine.local import local
from glue.errors import ConfigError, GlueError
from glue.plugins.loading import Trained, load_trained
from glue.roles import capabilities
from tests.forked import run
from tests.players import outcomes
from tests.terminal import Terminal


def sarsa(episodes: int) -> SarsaAgent:
    """Return SARSA after so many episodes in the mines."""
    agent = SarsaAgent()
    with local(agent, MinesEnvironment()) as glue:
        glue.rl_init(seed=1)
        outcomes(glue, episodes, 200)
    return agent


def test_what_was_learned_is_there_after_every_init() -> None:
    taught = sarsa(50)
    agent = Trained(SarsaAgent(), taught.agent_save())
    for _ in range(2):
        agent.agent_init(MinesEnvironment().env_init())
        assert agent.agent_message("values") == taught.agent_message("values")
        with local(agent, MinesEnvironment()) as glue:
            glue.rl_start()
            while not glue.rl_step().terminal:
                pass
        assert agent.agent_message("values") != taught.agent_message("values"), "it goes on learning"


def test_trained_agent_offers_what_the_agent_does() -> None:
    for agent in SarsaAgent(), SampleAgent():
        trained = Trained(agent, b"")
        assert capabilities(trained) == capabilities(agent)
        assert name_of(trained) == name_of(agent), "messages name what a person started"


def test_file_of_more_than_a_gibibyte_is_not_read(tmp_path: Path) -> None:
    with (tmp_path / "huge.agent").open("wb") as huge:
        huge.truncate(2**30 + 1)  # a sparse file
    with pytest.raises(ConfigError, match="more than 1,073,741,824 bytes"):
        load_trained(SarsaAgent(), tmp_path / "huge.agent")


def test_what_another_task_taught_is_refused_at_init() -> None:
    agent = Trained(SarsaAgent(), sarsa(3).agent_save())
    with local(agent, SkeletonEnvironment()) as glue, pytest.raises(GlueError, match="108 states"):
        glue.rl_init()


def test_loaded_agent_plays_from_the_command_line_as_it_had_learned(tmp_path: Path) -> None:
    learned = sarsa(200).agent_save()
    (tmp_path / "mines.agent").write_bytes(learned)
    with local(Trained(SarsaAgent(learning=False, epsilon=0), learned), MinesEnvironment()) as glue:
        glue.rl_init(seed=0)
        expected = outcomes(glue, 3, 60)
    hub = f"ipc://{tmp_path}/hub"
    greedy = ("--no-learning", "--epsilon", "0")
    with closing(
        Terminal("glue-agent", "sarsa", "--load", "mines.agent", *greedy, "--hub", hub, cwd=tmp_path)
    ) as agent:
        shown = run(
            *("glue-experiment", "--env", "mines", "--episodes", "3", "--max-steps", "60", "--json"),
            *("--bind", hub, "--out", "run"),
            cwd=tmp_path,
        )
        assert (shown.returncode, agent.end()) == (0, 0)
    *episodes, _ = map(json.loads, shown.stdout.splitlines())
    assert [(line["return"], line["steps"]) for line in episodes] == expected
