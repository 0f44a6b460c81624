"""PettingZoo's classic games, unmodified, played by one agent against others."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from glue import Action, Agent, Observation, local, make, make_agent
from glue.errors import ConfigError
from glue.roles import capabilities
from glue.taskspec import legal_values, parse_task_spec
from tests.hubs import over_the_hub
from tests.pages import DOCS, blocks

pytest.importorskip("pettingzoo.classic.tictactoe_v3", reason="needs PettingZoo: the extra pettingzoo")
pytestmark = pytest.mark.filterwarnings("ignore")


class Lowest(Agent):
    """Takes the lowest legal action, and records what it sees."""

    agent_masks = True

    def __init__(self) -> None:
        self.seen: list[Any] = []

    def agent_init(self, task_spec: str) -> None:
        self.actions = int(parse_task_spec(task_spec).actions.ints[0].ends[1]) + 1

    def agent_start(self, observation: Observation) -> Action:
        self.seen.append(observation)
        (legal,) = legal_values(observation, (self.actions,))
        return Action([int(np.flatnonzero(legal)[0])])

    def agent_step(self, reward: float, observation: Observation) -> Action:
        self.seen.append(reward)
        return self.agent_start(observation)

    def agent_end(self, reward: float) -> None:
        self.seen += [reward, "end"]


OPPONENT = f"{Path(__file__)}:Lowest"


def returns(agent: Agent, name: str, episodes: int, seed: int = 1, **options: Any) -> list[float]:
    with local(agent, make(f"pettingzoo:{name}", **options)) as experiment:
        experiment.rl_init(seed)
        found = []
        for _ in range(episodes):
            assert experiment.rl_episode(2000) != (name == "rps_v2")  # which cuts off after 15 rounds
            found.append(experiment.rl_return())
    return found


@pytest.mark.parametrize(
    ("name", "worth"),
    [
        ("tictactoe_v3", {-1, 0, 1}),
        ("connect_four_v3", {-1, 0, 1}),
        ("leduc_holdem_v4", {*np.arange(-14, 15) / 2}),
        ("texas_holdem_v4", {*np.arange(-100, 101) / 2}),
        ("rps_v2", {*range(-15, 16)}),
        ("go_v5", {-1, 0, 1}),
        ("chess_v6", {-1, 0, 1}),
    ],
)
@pytest.mark.parametrize("player", [0, 1])
def test_random_legal_moves_end_every_game_by_its_rules(name: str, worth: set[float], player: int) -> None:
    episodes = 1 if name in ("chess_v6", "go_v5") else 30
    found = returns(make_agent("random"), name, episodes, player=player)
    assert {*found} <= worth
    assert found == returns(make_agent("random"), name, episodes, player=player)
    if episodes > 1:
        assert found != returns(make_agent("random"), name, episodes, seed=2, player=player)


def test_a_game_is_played_in_turns_and_the_opponent_sees_its_own_side() -> None:
    """Noughts and crosses, each on the lowest free field, column by column: the first player wins."""
    environment: Any = make("pettingzoo:tictactoe_v3", opponent=OPPONENT)
    assert capabilities(environment) == ("mask", "seed", "truncate")
    agent = Lowest()
    with over_the_hub(agent, environment) as experiment:
        assert parse_task_spec(experiment.rl_init(1)).observations.counts == (18, 0, 0)
        assert experiment.rl_episode()
    *moves, reward, end = agent.seen
    boards = [seen.ints.reshape(9, 2) for seen in moves[::2]]
    assert [board[:, 0].nonzero()[0].tolist() for board in boards] == [[], [0], [0, 2], [0, 2, 4]]
    assert [board[:, 1].nonzero()[0].tolist() for board in boards] == [[], [1], [1, 3], [1, 3, 5]]
    assert (moves[1::2], reward, end) == ([0.0] * 3, 1.0, "end")


def test_who_moves_illegally_loses() -> None:
    class Stubborn(Lowest):
        agent_masks = False

        def agent_start(self, observation: Observation) -> Action:
            return Action([0])

    assert returns(Stubborn(), "tictactoe_v3", 2, opponent=OPPONENT) == [-1.0, -1.0]
    assert returns(Lowest(), "tictactoe_v3", 1, opponent=OPPONENT, player=1) == [-1.0]


def test_maskable_ppo_learns_to_beat_a_random_player(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As the page shows, and then as an agent."""
    pytest.importorskip("sb3_contrib", reason="needs sb3-contrib: the extra sb3")
    pytest.importorskip("torch").set_num_threads(1)
    page = (DOCS / "masks.md").read_text(encoding="utf-8")
    (example,) = (block.body for block in blocks(page, "python") if "MaskablePPO" in block.body)
    monkeypatch.chdir(tmp_path)
    exec(example, {})
    agent = make_agent("sb3", policy="model.zip", algorithm="MaskablePPO")
    assert sum(returns(agent, "tictactoe_v3", 100)) >= 55  # at random it is about 30


@pytest.mark.parametrize(
    ("name", "options", "message"),
    [
        ("checkers_v9", {}, "no module 'pettingzoo.classic.checkers_v9'"),
        ("json.decoder", {}, "no function env"),
        ("tictactoe_v3", {"player": 2}, "from 0 to 1"),
        ("tictactoe_v3", {"opponent": "nobody"}, "no agent is called 'nobody'"),
        ("hanabi_v5", {"players": 99}, "PettingZoo cannot make hanabi_v5"),
    ],
)
def test_what_cannot_be_played_is_a_config_error(name: str, options: Any, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        make(f"pettingzoo:{name}", **options)
