"""Proximal policy optimisation on many games of Infinite Mario at once: one file, to read and to change.

    pip install 'glue-rl[gym,torch]'
    python -m agents.ppo --levels train-200 --seed 1 --steps 5000000 --out runs/ppo-1.npz
    glue-generalise --agent agents.ppo:PpoAgent --agent-option policy=runs/ppo-1.npz

It learns from `gymnasium.make_vec` with SAME_STEP autoreset, on one thread. `PpoAgent` plays what it has
learned as an RL-Glue agent, anywhere.

Source: Schulman et al. (2017), Proximal policy optimization algorithms; Schulman et al. (2016),
High-dimensional continuous control using generalized advantage estimation.
"""

from __future__ import annotations

import argparse
import time
from collections import deque
from typing import Annotated

import numpy as np
import torch
from torch import nn

from agents.mario.views import tiles_and_sprites
from glue import Action, ConfigError, Observation, Option
from glue.roles import Agent

# What the network sees: a crop of the tiles around Mario, the sprites nearest to him, and himself.
ROWS = slice(3, 16)
COLUMNS = np.arange(-2, 10)  # from Mario
OTHERS = 4
KINDS = 9
FEATURES = 13 * len(COLUMNS) * 2 + len(COLUMNS) + 16 + OTHERS * (KINDS + 6) + 6
SOLID, LEDGE, GOAL, MARIO = (2, 4, 5, 6, 7), (1, 3), 9, 10
WHICH = np.zeros((3, 11), np.float32)
WHICH[0, list(SOLID)] = WHICH[1, list(LEDGE)] = WHICH[2, GOAL] = 1
MIDDLE = 10  # Mario's column when he cannot be seen: above the screen

# How it learns.
GAMES, LENGTH = 256, 32  # steps of each game between two updates
BATCH, EPOCHS = 1024, 2
GAMMA, LAMBDA = 0.99, 0.95
CLIP, ENTROPY, VALUE = 0.2, 0.002, 0.5
RATE = 7e-4
SCALE = 0.02  # of rewards, clipped to 10 either way, so that values are about 1
PROGRESS = 0.004  # for each tile to the right; with the goal alone there is nothing to climb


def features(tiles: np.ndarray, sprites: np.ndarray) -> np.ndarray:
    """Return the network's input, shape (N, FEATURES), from tiles (N, 16, 21) and sprites (N, 16, 7)."""
    count = len(tiles)
    found = (tiles == MARIO).reshape(count, -1)
    place = found.argmax(1)
    seen = found[np.arange(count), place]
    row, column = np.where(seen, place // 21, 0), np.where(seen, place % 21, MIDDLE)
    columns = np.clip(column[:, None] + COLUMNS, 0, 20)
    crop = np.take_along_axis(tiles[:, ROWS], columns[:, None, :], 2)
    mario, others = sprites[:, 0], sprites[:, 1 : 1 + OTHERS]
    kinds = others[..., 1:2] == np.arange(1, 1 + KINDS)
    parts = [
        WHICH[0][crop],
        WHICH[1][crop],
        WHICH[2][crop[:, 0]],
        row[:, None] == np.arange(16),
        kinds,
        others[..., [0, 2]],
        others[..., 3:] * 0.2,
        np.stack([mario[:, 1] == 10, mario[:, 1] == 11], 1),
        mario[:, 3:],
    ]
    return np.concatenate([part.reshape(count, -1).astype(np.float32) for part in parts], 1)


class Policy(nn.Module):  # type: ignore[misc]
    """Preferences for the 12 actions, and the value of what is seen."""

    def __init__(self) -> None:
        super().__init__()
        self.body: nn.Sequential = nn.Sequential(
            nn.Linear(FEATURES, 128), nn.ReLU(), nn.Linear(128, 64), nn.ReLU()
        )
        self.actor: nn.Linear
        self.critic: nn.Linear
        self.actor, self.critic = nn.Linear(64, 12), nn.Linear(64, 1)
        nn.init.orthogonal_(self.actor.weight, 0.01)

    def forward(self, seen: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        hidden = self.body(seen)
        return self.actor(hidden), self.critic(hidden)[:, 0]


def learn(levels: str, seed: int, steps: int, out: str) -> None:
    """Learn for `steps` steps on a set of levels; save the policy to `out` and print how it goes."""
    import gymnasium

    torch.set_num_threads(1)
    torch.manual_seed(seed)
    envs = gymnasium.make_vec(
        "env_server.gym:glue/InfiniteMario-v0",
        num_envs=GAMES,
        **({"num_levels": int(levels)} if levels.isdigit() else {"levels": levels}),
        action="discrete",
        autoreset_mode="SameStep",
        copy=False,
    )
    shown, _ = envs.reset(seed=GAMES * seed)
    policy = Policy()
    optimizer = torch.optim.Adam(policy.parameters(), RATE, eps=1e-5)
    returns = np.zeros(GAMES)
    ended: deque[tuple[float, bool]] = deque(maxlen=1000)
    began, cpu = time.perf_counter(), time.process_time()
    updates = -(-steps // (GAMES * LENGTH))
    for update in range(updates):
        optimizer.param_groups[0]["lr"] = RATE * (1 - update / updates)
        seen = np.empty((LENGTH + 1, GAMES, FEATURES), np.float32)
        rewards, over = np.empty((2, LENGTH, GAMES), np.float32)
        actions, chances, values = [], [], []
        for t in range(LENGTH + 1):
            seen[t] = features(shown["tiles"], shown["sprites"])
            with torch.no_grad():
                preferences, value = policy(torch.from_numpy(seen[t]))
            values.append(value)
            if t == LENGTH:
                break
            log_chances = preferences.log_softmax(1)
            action = torch.multinomial(log_chances.exp(), 1)
            actions.append(action[:, 0])
            chances.append(log_chances.gather(1, action)[:, 0])
            shown, reward, terminated, truncated, infos = envs.step(action[:, 0].numpy())
            done = terminated | truncated
            returns += reward
            for i in np.flatnonzero(done):
                ended.append((returns[i], infos["final_info"]["goal"][i]))
                returns[i] = 0
            speed = np.where(done, 0, shown["sprites"][:, 0, 5])
            rewards[t] = SCALE * np.clip(reward, -10, 10) + PROGRESS * speed
            over[t] = done
        _improve(
            policy, optimizer, seen[:LENGTH], actions, chances, torch.stack(values).numpy(), rewards, over
        )
        if update % 20 == 19 or update == updates - 1:
            played = (update + 1) * GAMES * LENGTH
            mean, goals = np.mean(ended, 0) if ended else (np.nan, np.nan)
            times = f"{time.perf_counter() - began:.0f} s, {time.process_time() - cpu:.0f} s of CPU"
            print(f"{played} steps: return {mean:.2f}, goal {goals:.3f}, {times}", flush=True)
            save(policy, out, played)
    envs.close()


def _improve(
    policy: Policy,
    optimizer: torch.optim.Optimizer,
    seen: np.ndarray,
    actions: list[torch.Tensor],
    chances: list[torch.Tensor],
    values: np.ndarray,
    rewards: np.ndarray,
    over: np.ndarray,
) -> None:
    """Change the policy by what was seen, shape (LENGTH, GAMES, FEATURES), and the results."""
    advantages, later = np.empty_like(rewards), np.zeros(GAMES, np.float32)
    for t in reversed(range(LENGTH)):
        goes_on = 1 - over[t]
        error = rewards[t] + GAMMA * values[t + 1] * goes_on - values[t]
        advantages[t] = later = error + GAMMA * LAMBDA * goes_on * later
    targets = torch.from_numpy((advantages + values[:LENGTH]).ravel())
    advantage = torch.from_numpy(advantages.ravel())
    advantage = (advantage - advantage.mean()) / (advantage.std() + 1e-8)
    inputs = torch.from_numpy(seen.reshape(-1, FEATURES))
    action, before = torch.cat(actions), torch.cat(chances)
    for _ in range(EPOCHS):
        for part in torch.randperm(len(inputs)).split(BATCH):
            preferences, value = policy(inputs[part])
            log_chances = preferences.log_softmax(1)
            ratio = (log_chances.gather(1, action[part][:, None])[:, 0] - before[part]).exp()
            gain = advantage[part]
            surrogate = torch.min(ratio * gain, ratio.clamp(1 - CLIP, 1 + CLIP) * gain).mean()
            entropy = -(log_chances.exp() * log_chances).sum(1).mean()
            loss = VALUE * (value - targets[part]).square().mean() - surrogate - ENTROPY * entropy
            optimizer.zero_grad()
            loss.backward()
            nn.utils.clip_grad_norm_(policy.parameters(), 0.5)
            optimizer.step()


def save(policy: Policy, path: str, steps: int) -> None:
    """Write the weights as arrays; nothing in the file is executed when it is read."""
    weights = {name: value.numpy() for name, value in policy.state_dict().items()}
    np.savez_compressed(path, steps=np.int64(steps), **weights)


def load(path: str) -> Policy:
    """Return the policy that `save` wrote."""
    policy = Policy()
    with np.load(path, allow_pickle=False) as saved:
        weights = {name: torch.from_numpy(saved[name]) for name in policy.state_dict()}
    policy.load_state_dict(weights)
    return policy


class PpoAgent(Agent):
    """Plays a policy that ppo.py has learned: an RL-Glue agent of Infinite Mario.

    Each action is drawn as in training; the same seed gives the same episodes.
    """

    def __init__(self, *, policy: Annotated[str, Option("file that ppo.py wrote")] = "") -> None:
        torch.set_num_threads(1)
        try:
            self._policy = load(policy)
        except (OSError, ValueError, KeyError, RuntimeError) as error:
            raise ConfigError(
                f"policy names a file that `python -m agents.ppo` wrote, not {policy!r}: {error}"
            ) from None
        self._entropy, self._actions = 0.0, 0
        self.agent_seed(0)

    def agent_seed(self, seed: int) -> None:
        self._random = np.random.default_rng(seed)

    def agent_start(self, observation: Observation) -> Action:
        self._entropy, self._actions = 0.0, 0
        return self.agent_step(0.0, observation)

    def agent_step(self, reward: float, observation: Observation) -> Action:
        with torch.no_grad():
            preferences, _ = self._policy(torch.from_numpy(features(*tiles_and_sprites(observation))))
        chances = preferences[0].double().softmax(0).numpy()
        self._entropy -= float(chances @ np.log(chances.clip(1e-300)))
        self._actions += 1
        number = min(int(np.searchsorted(np.cumsum(chances), self._random.random())), 11)
        return Action(ints=[number // 4 - 1, number // 2 % 2, number % 2])

    def agent_metrics(self) -> dict[str, float]:
        """Return the mean entropy of the policy in the episode, in nats."""
        return {"entropy": self._entropy / max(self._actions, 1)}

    def agent_message(self, message: str) -> str:
        return "I play what ppo.py has learned"


if __name__ == "__main__":
    parser: argparse.ArgumentParser = argparse.ArgumentParser(
        description="Learn Infinite Mario by proximal policy optimisation."
    )
    parser.add_argument("--levels", default="train-200", help="a set, or a number: levels 0 to N - 1")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--steps", type=int, default=5_000_000)
    parser.add_argument("--out", default="ppo.npz")
    given: argparse.Namespace = parser.parse_args()
    learn(given.levels, given.seed, given.steps, given.out)
