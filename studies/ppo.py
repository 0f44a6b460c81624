"""Proximal policy optimisation on many games of Infinite Mario at once: one file to read and to change.

    pip install --editable '.[gym]' 'torch>=2.2'
    python -m studies.ppo --levels 100000 --seed 1 --steps 5000000 --out runs/ppo-1.npz
    glue-generalise --agent network --agent-option policy=runs/ppo-1.npz

It learns from `gymnasium.make_vec` with SAME_STEP autoreset, on one thread, from scratch or from the
network of a file (`--start`). The agent `network` plays the learned policy, in NumPy, anywhere.

Source: Schulman et al. (2017), Proximal policy optimization algorithms; Schulman et al. (2016),
High-dimensional continuous control using generalized advantage estimation.
"""

from __future__ import annotations

import argparse
import time
from collections import deque
from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from torch import nn

from agents.mario.agent import NUM_ACTIONS
from agents.network.agent import FEATURES, NONE, RECENT, WIDTHS, Reals, features, load, remember, save
from glue.errors import ConfigError, GlueError

GAMES, LENGTH = 256, 64  # steps of each game between two updates
BATCH, EPOCHS = 2048, 1
GAMMA, LAMBDA = 0.995, 0.95
CLIP, ENTROPY, VALUE = 0.2, 0.002, 0.5
RATE = 4e-4
SCALE = 0.02  # of rewards, so that values are about 1
GOAL = 10  # instead of 100
DEATHS = -10, -80  # instead of -10, in the first update and after HARDENING: first move, then survive
HARDENING = 6104  # updates, 100 million steps
PROGRESS = 0.004  # for each tile to the right; a reward only at the goal would give no direction
VALUES_ONLY = 30  # first updates, which leave an initial network unchanged: its values are not known yet


class Policy(nn.Module):  # type: ignore[misc]
    """Preferences for the 12 actions, and the value of the inputs."""

    def __init__(self) -> None:
        super().__init__()
        first, second = WIDTHS
        self.body: nn.Sequential = nn.Sequential(
            nn.Linear(FEATURES, first), nn.ReLU(), nn.Linear(first, second), nn.ReLU()
        )
        self.actor: nn.Linear
        self.critic: nn.Linear
        self.actor, self.critic = nn.Linear(second, NUM_ACTIONS), nn.Linear(second, 1)
        nn.init.orthogonal_(self.actor.weight, 0.01)
        nn.init.zeros_(self.critic.weight)

    def forward(self, seen: torch.Tensor, values_only: bool = False) -> tuple[torch.Tensor, torch.Tensor]:
        hidden = self.body(seen)
        return self.actor(hidden), self.critic(hidden.detach() if values_only else hidden)[:, 0]

    def layers(self) -> list[nn.Linear]:
        """Return the layers of the network that plays."""
        return [self.body[0], self.body[2], self.actor]

    def start_from(self, path: str) -> None:
        """Load the network of a file.

        Raises:
            ConfigError: the file is missing, or holds no network of the same widths.
        """
        network = load(path)
        for i, layer in enumerate(self.layers()):
            if network[f"bias{i}"].shape != layer.bias.shape:
                raise ConfigError(
                    f"{path}: layer {i} has {len(network[f'bias{i}'])} units, not {len(layer.bias)}"
                )
            weights = {"weight": network[f"weight{i}"].T.copy(), "bias": network[f"bias{i}"]}
            layer.load_state_dict({name: torch.from_numpy(value) for name, value in weights.items()})

    def save(self, path: str) -> None:
        """Write the network that plays."""
        save(of_linear(self.layers()), path)


def of_linear(layers: Sequence[Any]) -> dict[str, Reals]:
    """Return a copy of the weights and biases of torch's linear layers."""
    weights = {f"weight{i}": layer.weight.detach().numpy().T.copy() for i, layer in enumerate(layers)}
    return weights | {f"bias{i}": layer.bias.detach().numpy().copy() for i, layer in enumerate(layers)}


def learn(levels: str, seed: int, steps: int, start: str, out: str) -> None:
    """Learn for `steps` steps on a set of levels; save the policy to `out` and print the progress."""
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
    if start:
        policy.start_from(start)
    optimizer = torch.optim.Adam(policy.parameters(), RATE, eps=1e-5)
    recent = np.full((GAMES, RECENT), NONE, np.int64)
    seen = np.empty((LENGTH + 1, GAMES, FEATURES), np.float32)
    rewards, over = np.empty((2, LENGTH, GAMES), np.float32)
    returns = np.zeros(GAMES)
    ended: deque[tuple[float, bool]] = deque(maxlen=1000)
    began, cpu = time.perf_counter(), time.process_time()
    updates = -(-steps // (GAMES * LENGTH))
    for update in range(updates):
        optimizer.param_groups[0]["lr"] = RATE * (1 - update / updates)
        death = np.interp(update / HARDENING, (0, 1), DEATHS)
        actions, chances, values = [], [], []
        for t in range(LENGTH + 1):
            seen[t] = features(shown["tiles"], shown["sprites"], recent)
            with torch.no_grad():
                preferences, value = policy(torch.from_numpy(seen[t]))
            values.append(value)
            if t == LENGTH:
                break
            log_chances = preferences.log_softmax(1)
            action = torch.multinomial(log_chances.exp(), 1)
            actions.append(action[:, 0])
            chances.append(log_chances.gather(1, action)[:, 0])
            numbers = action[:, 0].numpy()
            shown, reward, terminated, truncated, infos = envs.step(numbers)
            done = terminated | truncated
            remember(recent, numbers)
            recent[done] = NONE
            returns += reward
            for i in np.flatnonzero(done):
                ended.append((returns[i], infos["final_info"]["goal"][i]))
                returns[i] = 0
            speed = np.where(done, 0, shown["sprites"][:, 0, 5])
            counted = np.where(reward < -5, death, np.minimum(reward, GOAL))
            rewards[t] = SCALE * counted + PROGRESS * speed
            over[t] = done
        _improve(
            policy,
            optimizer,
            seen[:LENGTH],
            actions,
            chances,
            torch.stack(values).numpy(),
            rewards,
            over,
            values_only=bool(start) and update < VALUES_ONLY,
        )
        if update % 60 == 59 or update == updates - 1:
            played = (update + 1) * GAMES * LENGTH
            mean, goals = np.mean(ended, 0) if ended else (np.nan, np.nan)
            times = f"{time.perf_counter() - began:.0f} s, {time.process_time() - cpu:.0f} s of CPU"
            print(f"{played} steps: return {mean:.2f}, goal {goals:.3f}, {times}", flush=True)
            policy.save(out)
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
    values_only: bool,
) -> None:
    """Update the policy by the inputs `seen`, shape (LENGTH, GAMES, FEATURES), and the results."""
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
            preferences, value = policy(inputs[part], values_only)
            loss = VALUE * (value - targets[part]).square().mean()
            if not values_only:
                log_chances = preferences.log_softmax(1)
                ratio = (log_chances.gather(1, action[part][:, None])[:, 0] - before[part]).exp()
                gain = advantage[part]
                surrogate = torch.min(ratio * gain, ratio.clamp(1 - CLIP, 1 + CLIP) * gain).mean()
                entropy = -(log_chances.exp() * log_chances).sum(1).mean()
                loss -= surrogate + ENTROPY * entropy
            optimizer.zero_grad()
            loss.backward()
            nn.utils.clip_grad_norm_(policy.parameters(), 0.5)
            optimizer.step()


def main() -> None:
    """Learn by the options of the command line."""
    parser = argparse.ArgumentParser(description="Learn Infinite Mario by proximal policy optimisation.")
    parser.add_argument("--levels", default="100000", help="a set, or a number: levels 0 to N - 1")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--steps", type=int, default=5_000_000)
    parser.add_argument("--start", default="", help="file of an initial network")
    parser.add_argument("--out", default="ppo.npz")
    given = parser.parse_args()
    try:
        learn(given.levels, given.seed, given.steps, given.start, given.out)
    except GlueError as error:
        parser.error(str(error))


if __name__ == "__main__":
    main()
