"""Imitation of a search, by a network that sees what an agent sees: a file of the agent `network`.

    pip install --editable . 'torch>=2.2'
    python -m studies.imitation --seed 1 --states 1000000 --out imitation.npz
    glue-generalise --set test-1000 --agent network --agent-option policy=imitation.npz

A teacher that knows the level prices every action, and the network learns how much more each costs than the
cheapest, on average, as a mistake that kills one time in five is worth avoiding. The states are those that
the network itself reaches.

Source: Ross, Gordon and Bagnell (2011), A reduction of imitation learning and structured prediction to
no-regret online learning; Ross and Bagnell (2014), Reinforcement and imitation learning via interactive
no-regret learning.
"""

from __future__ import annotations

import argparse
import time
from typing import Any, Final

import numpy as np
import numpy.typing as npt
import torch
from torch import nn

from agents.mario.agent import NUM_ACTIONS
from agents.network.agent import (
    FEATURES,
    LAYERS,
    NONE,
    RECENT,
    WIDTHS,
    Network,
    Reals,
    features,
    preferences,
    remember,
    save,
)
from env_server.mario import InfiniteMario
from env_server.mario.level_sets import LevelSet
from env_server.mario.many.games import SAME_STEP, Games
from env_server.mario.many.views import VIEWS
from studies.ppo import of_linear
from studies.teacher import Teacher

_GAMES: Final = 256
_EPISODE: Final = 350  # steps; a level takes 100 to 250
_ROUND: Final = 16_000  # states between two trainings
_PRICED: Final = 0.3  # share of the states that are priced
_TAUGHT: Final = 0.15  # share of those in which the teacher acts
_RANDOM: Final = 0.03  # share of the actions that are random
_FIRST_RANDOM: Final = 0.15  # the same in the first round, in which the teacher acts in all states

_BATCH: Final = 1024
_BATCHES: Final = 400  # after each round
_PASSES: Final = 8  # through all states after the last round, while the rate falls
_RATE: Final = 1e-3
_LAST_RATE: Final = 1e-5
_DEAREST: Final = 12.0  # maximum steps above the best; higher prices are clipped


class States:
    """The states that were priced: their features, and the prices above the cheapest."""

    def __init__(self) -> None:
        self._seen: list[npt.NDArray[np.float16]] = []
        self._prices: list[Reals] = []
        self.count: int = 0

    def add(self, seen: Reals, prices: Reals) -> None:
        """Add some states."""
        self._seen.append(seen.astype(np.float16))
        self._prices.append(np.minimum(prices - prices.min(1, keepdims=True), _DEAREST))
        self.count += len(seen)

    def gathered(self) -> tuple[torch.Tensor, torch.Tensor]:
        """Return the features and prices of all states, shapes (S, F) and (S, 12)."""
        self._seen, self._prices = [np.concatenate(self._seen)], [np.concatenate(self._prices)]
        return torch.from_numpy(self._seen[0]), torch.from_numpy(self._prices[0])


class Player:
    """Plays N games with a network, and has its states priced."""

    def __init__(self, levels: int, seed: int) -> None:
        task = InfiniteMario().parameters
        self._random = np.random.default_rng(seed)
        self._games = Games(
            [task] * _GAMES, VIEWS["tiles"], SAME_STEP, max_steps=_EPISODE, levels=LevelSet(range(levels))
        )
        for i in range(_GAMES):
            self._games.seed(i, int(self._random.integers(2**63)))
        self._games.reset()
        self._teacher = Teacher(self._games)
        self._recent = np.full((_GAMES, RECENT), NONE, np.int64)
        self.ended: int = 0
        self.won: int = 0

    def play(self, network: Network | None, states: States, count: int) -> None:
        """Play until `count` states have been added; without a network, the teacher plays."""
        until = states.count + count
        self.ended = self.won = 0
        while states.count < until:
            self._step(network, states)

    def _step(self, network: Network | None, states: States) -> None:
        games, random = self._games, self._random
        seen = features(games.cells.reshape(-1, 16, 21), games.reals.reshape(-1, 16, 7), self._recent)
        priced = np.flatnonzero(random.random(_GAMES) < (1.0 if network is None else _PRICED))
        prices = self._teacher.prices(priced)
        states.add(seen[priced], prices)
        taught = random.random(len(priced)) < (1.0 if network is None else _TAUGHT)
        actions = np.zeros(_GAMES, np.int64) if network is None else preferences(network, seen).argmax(1)
        actions[priced[taught]] = self._teacher.plans[priced[taught], 0].clip(0)
        at_random = random.random(_GAMES) < (_FIRST_RANDOM if network is None else _RANDOM)
        actions[at_random] = random.integers(NUM_ACTIONS, size=int(at_random.sum()))
        self._teacher.follow(actions)
        games.step(actions[:, None], np.array([NUM_ACTIONS]))
        remember(self._recent, actions)
        over = games.lanes["terminated"].astype(bool) | games.lanes["truncated"].astype(bool)
        self._recent[over] = NONE
        self._teacher.plans[over] = -1
        self.ended += int(over.sum())
        self.won += int(games.lanes["final_info"][over][:, 1].sum())


class Learner:
    """The network in training."""

    def __init__(self, seed: int) -> None:
        torch.manual_seed(seed)
        torch.set_num_threads(1)
        self._chance = torch.Generator().manual_seed(seed)
        widths = (FEATURES, *WIDTHS, NUM_ACTIONS)
        layers: list[Any] = []
        for layer in range(LAYERS):
            layers += [nn.Linear(widths[layer], widths[layer + 1]), nn.ReLU()]
        self._layers = nn.Sequential(*layers[:-1])
        self._optimizer = torch.optim.Adam(self._layers.parameters(), _RATE)

    def train(self, states: States, batches: int, last_rate: float = _RATE) -> float:
        """Train on `batches` batches, with a rate that ends at `last_rate`; return the mean squared error."""
        seen, prices = states.gathered()
        total = 0.0
        for batch in range(batches):
            self._optimizer.param_groups[0]["lr"] = _RATE + (last_rate - _RATE) * batch / batches
            chosen = torch.randint(len(seen), (_BATCH,), generator=self._chance)
            loss = nn.functional.mse_loss(self._layers(seen[chosen].float()), prices[chosen])
            self._optimizer.zero_grad()
            loss.backward()
            self._optimizer.step()
            total += loss.item()
        return total / batches

    def network(self) -> dict[str, Reals]:
        """Return the weights for the agent, which prefers actions that cost less."""
        weights, last = of_linear(list(self._layers)[::2]), LAYERS - 1
        return weights | {name: -weights[name] for name in (f"weight{last}", f"bias{last}")}


def learn(levels: int, seed: int, count: int, out: str) -> None:
    """Learn from `count` states on `levels` levels, print the progress, and save each network to `out`."""
    player, learner, states = Player(levels, seed), Learner(seed), States()
    network, began = None, time.perf_counter()
    while states.count < count:
        player.play(network, states, _ROUND)
        error = learner.train(states, _BATCHES)
        network = learner.network()
        save(network, out)
        goals = player.won / max(player.ended, 1)
        seconds = time.perf_counter() - began
        print(
            f"{states.count} states: error {error:.3f}, goal {goals:.3f} with some help, {seconds:.0f} s",
            flush=True,
        )
    error = learner.train(states, _PASSES * states.count // _BATCH, _LAST_RATE)
    save(learner.network(), out)
    print(f"the end: error {error:.3f}, {time.perf_counter() - began:.0f} s", flush=True)


def main() -> None:
    """Learn by the options of the command line."""
    parser = argparse.ArgumentParser(
        description="Teach a network to play levels of Infinite Mario that it has not seen."
    )
    parser.add_argument("--levels", type=int, default=100_000, help="levels 0 to N - 1")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--states", type=int, default=1_000_000)
    parser.add_argument("--out", default="imitation.npz")
    given = parser.parse_args()
    learn(given.levels, given.seed, given.states, given.out)


if __name__ == "__main__":
    main()
