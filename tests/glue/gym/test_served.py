"""Gymnasium environments have the same trajectories served by RL-Glue, and wrapped back, as alone."""

from __future__ import annotations

import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from glue import Action, Agent, Environment, Observation, local, make
from glue.cli.screen import renderer
from glue.engine.engine import role_seed
from glue.engine.experiment import Experiment
from glue.errors import ConfigError, PeerFailed, SimulatorError
from glue.global_seeds import globals_restored
from glue.options import parameters
from glue.pace import Pace
from glue.plugins.loading import construct, find, without_seed
from glue.roles import capabilities
from glue.taskspec import parse_task_spec
from glue.wire.messages import Role
from tests.hubs import hub_with, over_the_hub

gymnasium: Any = pytest.importorskip("gymnasium", reason="needs Gymnasium: the extra gym")
import glue.gym  # noqa: E402
import tests.glue.gym.environments  # noqa: E402, F401
from glue.gym.spaces import Codec, read_spaces  # noqa: E402
from glue.gym.vectors import infos_of_step  # noqa: E402

pytestmark = pytest.mark.filterwarnings("ignore")

Glue = Callable[[Agent, Environment], AbstractContextManager[Experiment]]
SEED = 11
NAMES: dict[str, dict[str, Any]] = {
    "CartPole-v1": {},
    "Taxi-v4": {"max_episode_steps": 20},
    "FrozenLake-v1": {"is_slippery": True},
    "Blackjack-v1": {},
    "Pendulum-v1": {"g": 9.81, "max_episode_steps": 30},
    "LunarLander-v3": {},
    "tests/Nested-v0": {"length": 4},
}


class Playing(Agent):
    """An agent that plays random actions and records every observation and reward."""

    def __init__(self, space: Any) -> None:
        self._codec = Codec(space)
        space.seed(SEED)
        self.seen: list[Any] = []

    def act(self) -> Action:
        return Action(*self._codec.pack(self._codec.space.sample()))

    def agent_start(self, observation: Observation) -> Action:
        self.seen.append(observation)
        return self.act()

    def agent_step(self, reward: float, observation: Observation) -> Action:
        self.seen += [reward, observation]
        return self.act()

    def agent_end(self, reward: float) -> None:
        self.seen += [reward, "end"]


def alone(name: str, options: dict[str, Any], episodes: int) -> list[Any]:
    """Return the rewards and observations of Gymnasium without RL-Glue."""
    env = gymnasium.make(name, **options)
    env.action_space.seed(SEED)
    codec = Codec(env.observation_space)
    seen: list[Any] = []
    for episode in range(episodes):
        seed = role_seed(SEED, Role.ENVIRONMENT) if episode == 0 else None
        seen.append(Observation(*codec.pack(env.reset(seed=seed)[0])))
        terminated = truncated = False
        while not (terminated or truncated):
            shown, reward, terminated, truncated, _ = env.step(env.action_space.sample())
            seen += [float(reward), "end" if terminated else Observation(*codec.pack(shown))]
        if truncated and not terminated:
            env.action_space.sample()  # the agent answers the last observation, too
    env.close()
    return seen


def made(name: str) -> None:
    try:
        gymnasium.make(name).close()
    except gymnasium.error.Error as error:
        pytest.skip(f"{name} does not install here: {error}")


@pytest.mark.parametrize(
    ("glue", "name"), [(over_the_hub, "tests/Nested-v0"), *((local, name) for name in NAMES)]
)
def test_the_same_trajectories_as_gymnasium_alone(glue: Glue, name: str) -> None:
    made(name)
    options = NAMES[name]
    environment = make(f"gymnasium:{name}", **options)
    agent = Playing(gymnasium.make(name, **options).action_space)
    with glue(agent, environment) as experiment:
        experiment.rl_init(SEED)
        for _ in range(3):
            experiment.rl_episode()
        experiment.rl_cleanup()
    assert agent.seen == alone(name, options, 3)


@contextmanager
def wrapped(name: str) -> Iterator[Any]:
    env = glue.gym.wrap(make(f"gymnasium:{name}"))
    yield env
    env.close()


@contextmanager
def connected(name: str) -> Iterator[Any]:
    with hub_with(make(f"gymnasium:{name}")) as hub:
        env = glue.gym.connect(hub)
        yield env
        env.close()


@pytest.mark.parametrize(
    ("way", "name"),
    [(connected, "tests/Nested-v0"), *((wrapped, f"{name}-v1") for name in ("CartPole", "Blackjack"))],
)
def test_there_and_back_again(name: str, way: Callable[[str], AbstractContextManager[Any]]) -> None:
    direct = gymnasium.make(name)
    with way(name) as env:
        assert (env.observation_space, env.action_space) == (direct.observation_space, direct.action_space)
        direct.action_space.seed(SEED)
        codec = Codec(direct.observation_space)
        shown, _ = env.reset(seed=SEED)
        expected, _ = direct.reset(seed=role_seed(SEED, Role.ENVIRONMENT))
        over = False
        while not over:
            assert Observation(*codec.pack(shown)) == Observation(*codec.pack(expected))
            action = direct.action_space.sample()
            shown, *outcome, _ = env.step(action)
            expected, *direct_outcome, _ = direct.step(action)
            if outcome[1]:
                expected = shown  # in RL-Glue the agent sees no observation at a terminal step
            assert outcome == [float(direct_outcome[0]), *direct_outcome[1:]]
            over = outcome[1] or outcome[2]
        with pytest.raises(SimulatorError, match="call reset"):
            env.step(action)


def test_a_session_that_was_left_takes_the_next_experiment(monkeypatch: pytest.MonkeyPatch) -> None:
    failed: list[object] = []
    monkeypatch.setattr(threading, "excepthook", failed.append)
    earlier: set[threading.Thread] = set()
    with hub_with(make("gymnasium:CartPole-v1")) as hub:
        for _ in range(2):
            env = glue.gym.connect(hub)
            new = {one for one in threading.enumerate() if one.name == "stand-in agent"} - earlier
            earlier |= new
            env.close()
        for stand_in in new:
            stand_in.join()
    assert failed == []


def test_a_session_whose_task_gymnasium_cannot_read_is_left(monkeypatch: pytest.MonkeyPatch) -> None:
    skeleton = make("skeleton")
    monkeypatch.setattr(skeleton, "env_init", lambda: "no task spec", raising=False)
    failures = []
    with hub_with(skeleton) as hub:
        for _ in range(2):
            with pytest.raises(ConfigError, match="cannot be read") as failure:
                glue.gym.connect(hub, wait=60)
            failures.append(failure)  # which would keep what was not closed


def test_a_hub_that_does_not_wait_is_refused() -> None:
    with hub_with(make("skeleton"), pace=Pace(delay=1)) as hub:
        for _ in range(2):  # the session was left
            with pytest.raises(ConfigError, match="the hub has a rate or a delay"):
                glue.gym.connect(hub, wait=60)


def test_check_env_passes_for_an_environment_behind_a_hub() -> None:
    from gymnasium.utils.env_checker import check_env

    with hub_with(make("gymnasium:CartPole-v1")) as hub:
        env = glue.gym.connect(hub)
        check_env(env, skip_render_check=True)
        env.close()


def test_environments_that_never_heard_of_gymnasium() -> None:
    for name in ("skeleton", "mines", "mario"):
        env = glue.gym.wrap(make(name))
        shown, _ = env.reset(seed=1)
        assert env.observation_space.contains(shown)
        env.action_space.seed(1)
        for _ in range(5):
            shown, _, terminated, truncated, _ = env.step(env.action_space.sample())
            assert env.observation_space.contains(shown)
            if terminated or truncated:
                env.reset()
        with pytest.raises(SimulatorError, match="is not in"):
            env.step(10**6)
        env.close()


def test_many_sessions_are_a_vector_environment() -> None:
    sessions = ["one", "two", "three"]
    with hub_with({name: make("gymnasium:CartPole-v1") for name in sessions}) as hub:
        envs = glue.gym.connect_vec(hub, sessions)
        shown, _ = envs.reset(seed=3)
        for i in range(3):
            expected, _ = gymnasium.make("CartPole-v1").reset(seed=role_seed(3 + i, Role.ENVIRONMENT))
            assert shown[i].tobytes() == expected.tobytes()
        for _ in range(30):
            shown, *_ = envs.step(envs.action_space.sample())
        assert shown.shape == (3, 4)
        envs.close()


def test_an_action_outside_the_space_is_an_error_and_the_environment_is_unharmed() -> None:
    environment = make("gymnasium:CartPole-v1")
    with local(Playing(gymnasium.make("CartPole-v1").action_space), environment) as experiment:
        experiment.rl_init(SEED)
        experiment.rl_env_start()
        for wrong in (Action([2]), Action([-1]), Action([0, 1]), Action(), Action(doubles=[0.0])):
            with pytest.raises(PeerFailed, match=r"not in Discrete|expected 1 ints|the task spec says"):
                experiment.rl_env_step(wrong)
        direct = gymnasium.make("CartPole-v1")
        direct.reset(seed=role_seed(SEED, Role.ENVIRONMENT))
        expected = direct.step(1)[0].astype(np.float64)
        assert experiment.rl_env_step(Action([1]))[1] == Observation(doubles=expected)


def test_options_are_keywords_of_the_environment() -> None:
    known = parameters(find(Role.ENVIRONMENT, "gymnasium:tests/Nested-v0"))
    assert {name: parameter.type for name, parameter in known.items()} == {
        "length": int, "ends": str, "shift": float, "on": bool, "max_episode_steps": int,
        "action_mask": bool, "infos": str,
    }  # fmt: skip
    for name, options, message in (
        ("gymnasium:CartPol-v1", {}, "Did you mean"),
        ("gymnasium:nowhere:X-v1", {}, "no environment"),
        ("gymnasium:CartPole-v1", {"lenght": 3}, "no option lenght"),
        ("gymnasium:CartPole-v1", {"max_episode_steps": 0}, "at least 1"),
        ("gymnasium:FrozenLake-v1", {"map_name": "9x9"}, "9x9"),
        ("CartPole-v1", {}, r"did you mean gymnasium:CartPole-v1\?"),
    ):
        with pytest.raises(ConfigError, match=message):
            make(name, **options)


def test_it_can_be_saved_only_where_it_saves_itself() -> None:
    assert capabilities(make("gymnasium:CartPole-v1")) == ("seed", "truncate")

    class Saving(gymnasium.Env):  # type: ignore[misc]
        observation_space = action_space = gymnasium.spaces.Discrete(2)
        env_save = env_load = lambda *_: b"state"

    assert capabilities(glue.gym.GymnasiumEnvironment(Saving)) == ("save", "seed", "truncate")


def test_stepping_without_an_episode_is_refused() -> None:
    environment = make("gymnasium:CartPole-v1")
    environment.env_init()
    with pytest.raises(SimulatorError, match="env_start"):
        environment.env_step(Action([0]))
    assert "Discrete(2)" in environment.env_message("spaces")
    environment.env_cleanup()
    with pytest.raises(SimulatorError, match="env_init"):
        environment.env_start()


class OldSeeds(gymnasium.Env[Any, Any]):  # type: ignore[misc]
    """Draws from NumPy's global generator, which it seeds."""

    observation_space = action_space = gymnasium.spaces.Discrete(2)

    def reset(self, *, seed: Any = None, options: Any = None) -> Any:
        if seed is not None:
            np.random.seed(seed)
        return 0, {}

    def step(self, action: Any) -> Any:
        return 0, np.random.random(), False, False, {}


class NoSeeds(OldSeeds):
    """Ignores its seed."""

    def reset(self, *, seed: Any = None, options: Any = None) -> Any:
        return 0, {}


@pytest.mark.parametrize(("made", "seeded"), [(OldSeeds, True), (NoSeeds, False)])
def test_environments_of_the_old_global_generator_repeat_themselves(made: type, seeded: bool) -> None:
    gymnasium.register(f"tests/{made.__name__}-v0", made)
    found = find(Role.ENVIRONMENT, f"gymnasium:tests/{made.__name__}-v0")
    assert (without_seed(Role.ENVIRONMENT, "mine", found) is None) == seeded

    def rewards(seed: int) -> list[float]:
        environment = construct(found, {})
        environment.env_seed(seed)
        environment.env_init()
        environment.env_start()
        return [environment.env_step(Action([0])).reward for _ in range(3)]

    with globals_restored():
        assert rewards(2**62 + 1) == rewards(2**62 + 1) != rewards(2)


def test_a_module_of_the_working_directory_is_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "my_tasks.py").write_text(
        "import gymnasium\n"
        "from gymnasium.envs.classic_control import CartPoleEnv\n"
        "gymnasium.register('Mine/Pole-v0', CartPoleEnv)\n"
    )
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("sys.path", [*sys.path])
    environment = make("gymnasium:my_tasks:Mine/Pole-v0")
    environment.env_init()
    assert environment.env_start().counts == (0, 4, 0)
    with pytest.raises(ConfigError, match="no_tasks"):
        make("gymnasium:no_tasks:Mine/Pole-v0")


def test_an_environment_that_draws_text_is_drawn_so() -> None:
    environment = make("gymnasium:FrozenLake-v1", is_slippery=False)
    environment.env_init()
    observation = environment.env_start()
    lines = renderer(environment)(observation, False)
    assert "".join(lines).count("H") == 4
    plain = make("gymnasium:CartPole-v1")
    plain.env_init()
    assert renderer(plain)(observation, False) == ["Observation(ints=[0])"]


@pytest.mark.parametrize("form", ["vector", "single"])
def test_statistics_of_ended_episodes_reach_the_infos_of_their_game(form: str) -> None:
    mode: dict[str, Any] = {"vectorization_mode": "sync", "vector_kwargs": {"autoreset_mode": "SameStep"}}
    if form == "single":
        mode["wrappers"] = [gymnasium.wrappers.RecordEpisodeStatistics]
    envs = gymnasium.make_vec("CartPole-v1", num_envs=2, max_episode_steps=5, **mode)
    if form == "vector":
        envs = gymnasium.wrappers.vector.RecordEpisodeStatistics(envs)
    envs.reset(seed=1)
    for step in range(5):
        _, _, terminated, truncated, infos = envs.step(np.array([step % 2] * 2))
        parts = infos_of_step(infos, terminated, truncated)
        assert ["episode" in part for part in parts] == [step == 4] * 2
    assert [(part["episode"]["r"], part["episode"]["l"]) for part in parts] == [(5.0, 5)] * 2
    assert [part["TimeLimit.truncated"] for part in parts] == [True] * 2
    assert parts[0]["terminal_observation"].shape == (4,)
    envs.close()


def test_mario_served_shows_policies_the_spaces_that_they_were_trained_on() -> None:
    name = "env_server.gym:glue/InfiniteMario-v0"
    served = make(f"gymnasium:{name}")
    trained_on = gymnasium.make(name)
    assert read_spaces(parse_task_spec(served.env_init())) == (
        trained_on.observation_space,
        trained_on.action_space,
    )
    observation = served.env_start()
    assert len(renderer(served)(observation, False)) > 16, "drawn as a game, not as numbers"
