"""Steps that Stable-Baselines3's PPO takes to learn a level of Infinite Mario, as a table and a picture.

    pip install 'glue-rl[sb3,plot]'
    python -m benchmarks.learning --picture docs/images/sb3-level-121.png

PPO is unmodified. Rewards are divided by their running deviation (VecNormalize), because the goal pays 100
and a step -0.01.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import gymnasium
import numpy as np

from glue.gym.sb3 import SB3VecEnv

_LEVEL = {"level_seed": 121, "level_difficulty": 0}
_GAMES, _LENGTH = 32, 128  # steps of each game between two updates
_LAST = 100  # episodes whose outcome is shown
_STEPS = 300_000
_SEEDS = (1, 2, 3)


class Progress(NamedTuple):
    """Agent steps, seconds, CPU seconds, and the share of goals in the last 100 episodes."""

    steps: int
    seconds: float
    cpu: float
    goals: float


def learn(seed: int, steps: int = _STEPS) -> Iterator[Progress]:
    """Learn level 121 at difficulty 0 on one thread; yield the progress after each update."""
    import torch
    from stable_baselines3 import PPO
    from stable_baselines3.common.vec_env import VecNormalize

    torch.set_num_threads(1)  # networks as small as this gain nothing from more
    games = gymnasium.make_vec(
        "env_server.gym:glue/InfiniteMario-v0", num_envs=_GAMES, autoreset_mode="SameStep", **_LEVEL
    )
    envs = VecNormalize(SB3VecEnv(games), norm_obs=False)
    model = PPO(
        "MultiInputPolicy",
        envs,
        learning_rate=7e-4,
        n_steps=_LENGTH,
        batch_size=512,
        n_epochs=4,
        ent_coef=0.005,
        seed=seed,
        device="cpu",
    )
    ended: list[bool] = []

    def note(local: dict[str, Any], _: object) -> bool:
        ended.extend(bool(local["infos"][i]["goal"]) for i in np.flatnonzero(local["dones"]))
        return True

    began, used = time.perf_counter(), time.process_time()
    while model.num_timesteps < steps:
        model.learn(_GAMES * _LENGTH, note, reset_num_timesteps=False)
        goals = float(np.mean(ended[-_LAST:])) if ended else 0.0
        yield Progress(model.num_timesteps, time.perf_counter() - began, time.process_time() - used, goals)
    envs.close()


def main() -> None:
    """Learn with each of three seeds, print a table, and draw the curves."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--picture", type=Path, help="file to write, .png or .svg")
    parser.add_argument("--steps", type=int, default=_STEPS)
    given = parser.parse_args()
    curves = []
    print("| seed | steps until 50 % | until 90 % | goals in the end | steps | seconds | of CPU |")
    print("| ---: | ---: | ---: | ---: | ---: | ---: | ---: |")
    for seed in _SEEDS:
        curve = [*learn(seed, given.steps)]
        last = curve[-1]
        half, most = (_when(curve, share) for share in (0.5, 0.9))
        end = f"{last.goals:.2f} | {last.steps:,} | {last.seconds:.0f} | {last.cpu:.0f}"
        print(f"| {seed} | {half} | {most} | {end} |", flush=True)
        curves.append(curve)
    if given.picture is not None:
        _draw(curves, given.picture)


def _when(curve: list[Progress], share: float) -> str:
    return next((f"{one.steps:,}" for one in curve if one.goals >= share), "never")


def _draw(curves: list[list[Progress]], path: Path) -> None:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7, 3.5), layout="constrained")
    axes = figure.subplots()
    for seed, curve in zip(_SEEDS, curves, strict=True):
        axes.plot([one.steps for one in curve], [one.goals for one in curve], label=f"seed {seed}")
    axes.set_xlabel("agent steps")
    axes.set_ylabel(f"goals in the last {_LAST} episodes")
    axes.set_ylim(0, 1)
    axes.grid(alpha=0.3)
    axes.legend()
    figure.savefig(path, dpi=100)


if __name__ == "__main__":
    main()
