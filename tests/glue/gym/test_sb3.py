"""Stable-Baselines3, unmodified, learns through the adapter and through the hub.

The stage `gymnasium` of `.ci/run` installs it.
"""

from __future__ import annotations

import re
import shlex
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from glue import local, make, make_agent
from glue.errors import ConfigError, PeerFailed
from tests.forked import run
from tests.hubs import hub_with
from tests.pages import blocks
from tests.players import outcomes

sb3: Any = pytest.importorskip("stable_baselines3", reason="needs Stable-Baselines3: the extra sb3")
gymnasium: Any = pytest.importorskip("gymnasium")
# Networks as small as these gain nothing from more threads, which wait for each other on a busy machine.
pytest.importorskip("torch").set_num_threads(1)
import glue.gym  # noqa: E402
from benchmarks.learning import learn  # noqa: E402
from glue.gym.sb3 import SB3VecEnv  # noqa: E402

PAGE = (Path(__file__).parents[3] / "docs" / "gymnasium.md").read_text(encoding="utf-8")
MARIO = "env_server.gym:glue/InfiniteMario-v0"
pytestmark = pytest.mark.filterwarnings("ignore")


def mario(count: int, **options: Any) -> Any:
    return SB3VecEnv(gymnasium.make_vec(MARIO, num_envs=count, autoreset_mode="SameStep", **options))


def test_adapter_says_what_was_truncated_and_shows_the_last_observation() -> None:
    envs = mario(3, max_episode_steps=4, max_trial_steps=6)
    single = gymnasium.make(MARIO, max_episode_steps=4, max_trial_steps=6)
    envs.seed(5)
    shown = envs.reset()
    expected, _ = single.reset(seed=5)
    assert shown["tiles"][0].tobytes() == expected["tiles"].tobytes()
    assert envs.reset_infos[0]["level_seed"] == 121
    for step in range(4):
        shown, rewards, done, infos = envs.step(np.array([[2, 0, 1]] * 3))
        expected, reward, *_ = single.step(np.array([2, 0, 1]))
        assert rewards[0] == np.float32(reward)
        assert done.tolist() == [step == 3] * 3
    assert infos[0]["TimeLimit.truncated"] is True
    assert infos[0]["terminal_observation"]["sprites"].tobytes() == expected["sprites"].tobytes()
    assert shown["sprites"][0].tobytes() != expected["sprites"].tobytes()
    envs.close()


def test_adapter_needs_episodes_that_begin_in_the_same_step_and_observations_that_stay() -> None:
    with pytest.raises(ConfigError, match="SameStep"):
        SB3VecEnv(gymnasium.make_vec(MARIO, num_envs=1))
    with pytest.raises(ConfigError, match="copy=True"):
        mario(1, copy=False)


def test_a_mario_that_dies_is_not_truncated() -> None:
    envs = mario(1, max_trial_steps=2)
    envs.reset()
    envs.step(np.array([[1, 0, 0]]))
    _, _, done, infos = envs.step(np.array([[1, 0, 0]]))
    assert done.tolist() == [True]
    assert (infos[0]["TimeLimit.truncated"], infos[0]["timeout"]) == (False, True)
    envs.close()


def test_the_documented_example_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (example,) = (body for _, _, body in blocks(PAGE, "python") if body.startswith("import gymnasium\n"))
    monkeypatch.chdir(tmp_path)
    exec(example.replace("200_000", "1"), {})
    assert (tmp_path / "model.zip").is_file()


def test_ppo_learns_cartpole_through_the_hub(tmp_path: Path) -> None:
    with hub_with(make("gymnasium:CartPole-v1")) as hub:
        env = glue.gym.connect(hub)
        model = sb3.PPO(
            "MlpPolicy", env, n_steps=256, batch_size=64, learning_rate=1e-3, seed=1, device="cpu"
        )
        before = mean_return(env, model)
        model.learn(8_000)
        after = mean_return(env, model)
        model.save(tmp_path / "model")
        env.close()
    assert before < 60
    assert after > 150
    agent = make_agent("sb3", policy=str(tmp_path / "model.zip"))
    with local(agent, make("gymnasium:CartPole-v1")) as experiment:
        experiment.rl_init(1)
        assert np.mean([total for total, _ in outcomes(experiment, 5)]) > 150
    with (
        local(agent, make("gymnasium:Pendulum-v1")) as experiment,
        pytest.raises(PeerFailed, match="was trained on"),
    ):
        experiment.rl_init()


def mean_return(env: Any, model: Any) -> float:
    total = 0.0
    for seed in range(5):
        shown, _ = env.reset(seed=seed)
        over = False
        while not over:
            action, _ = model.predict(shown, deterministic=True)
            shown, reward, terminated, truncated, _ = env.step(action)
            total += reward
            over = terminated or truncated
    return total / 5


def test_a_policy_that_is_none_is_refused(tmp_path: Path) -> None:
    wrong = tmp_path / "model.zip"
    wrong.write_bytes(b"nothing")
    for path, message in ((tmp_path / "none.zip", "there is no policy"), (wrong, "is not a policy of PPO")):
        with pytest.raises(ConfigError, match=message):
            make_agent("sb3", policy=str(path))


def test_ppo_learns_to_finish_level_121() -> None:
    """This seed takes 204,800 steps, half a minute of CPU on the machine of docs/gymnasium.md."""
    progress = next((one for one in learn(seed=1) if one.goals >= 0.9), None)
    assert progress is not None, "fewer than 90 of 100 episodes reached the goal"
    print(progress)


def test_policy_trained_on_mario_is_watched_as_the_readme_says(tmp_path: Path) -> None:
    model = sb3.PPO("MultiInputPolicy", mario(2), n_steps=8, batch_size=16, n_epochs=1)
    model.learn(16)
    model.save(tmp_path / "model")
    readme = (Path(__file__).parents[3] / "README.md").read_text(encoding="utf-8")
    lines = [line for line in readme.splitlines() if line.startswith("glue-") and "--agent sb3" in line]
    assert len(lines) == 2
    for line in lines:
        command = shlex.split(re.sub(r" --episodes \d+", "", line))
        shown = run(*command, "--episodes", "1", "--max-steps", "5", cwd=tmp_path)
        assert shown.returncode == 0, shown.stderr
