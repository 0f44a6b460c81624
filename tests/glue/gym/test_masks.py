"""Masks and extras between RL-Glue and Gymnasium, in both directions, single and in vectors."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from agents.baselines import RandomAgent
from glue import Action, Agent, Environment, Observation, Step, local, make, make_agent
from glue.errors import ConfigError, PeerFailed, SimulatorError
from glue.roles import capabilities
from glue.taskspec import parse_task_spec
from glue.taskspec.spaces import Box, Discrete, Tuple, task_spec
from tests.hubs import hub_with
from tests.players import outcomes

gymnasium: Any = pytest.importorskip("gymnasium", reason="needs Gymnasium: the extra gym")
from gymnasium import spaces  # noqa: E402

import glue.gym  # noqa: E402
import tests.glue.gym.environments  # noqa: E402, F401
from glue.gym.spaces import MaskCodec  # noqa: E402

ONES = np.ones(2, np.int8)


def plain(mask: Any) -> Any:
    """Return a mask with lists in place of arrays."""
    if isinstance(mask, dict):
        return {key: plain(part) for key, part in mask.items()}
    return tuple(map(plain, mask)) if isinstance(mask, tuple) else mask if mask is None else mask.tolist()


SPACES: dict[str, tuple[Any, Any, list[int]]] = {
    "Discrete": (spaces.Discrete(4, start=-1), np.array([0, 1, 1, 0], np.int8), [0, 1, 1, 0]),
    "MultiDiscrete": (
        spaces.MultiDiscrete([3, 2]),
        (np.array([0, 0, 1], np.int8), np.array([1, 1], np.int8)),
        [0, 0, 1, 1, 1],
    ),
    "two axes": (
        spaces.MultiDiscrete([[1, 2], [2, 1]]),
        ((np.array([1]), np.array([1, 0])), (np.array([0, 1]), np.array([1]))),
        [1, 1, 0, 0, 1, 1],
    ),
    "MultiBinary": (spaces.MultiBinary(3), np.array([0, 1, 2], np.int8), [1, 0, 0, 1, 1, 1]),
    "nested": (
        spaces.Dict(
            b=spaces.Tuple([spaces.Box(0, 1, (2,)), spaces.Discrete(2)]),
            a=spaces.Box(np.array([1, -1]), np.array([2, 1]), dtype=np.int16),
        ),
        {"a": (np.array([0, 1]), np.array([1, 0, 1])), "b": (None, np.array([1, 0]))},
        [0, 1, 1, 0, 1, 1, 0],
    ),
}


@pytest.mark.parametrize("name", SPACES)
def test_a_mask_has_one_form_there_and_another_here(name: str) -> None:
    space, mask, bits = SPACES[name]
    codec = MaskCodec(space)
    assert codec.pack(mask).tolist() == [bool(bit) for bit in bits]
    observation = Observation(mask=codec.pack(mask))
    assert plain(codec.unpack(observation)) == plain(mask)
    assert codec.flat(observation).tolist() == [bool(bit) for bit in bits]
    assert codec.flat(Observation()).all()
    if name != "nested":  # Gymnasium has no masks of a Box of ints
        space.seed(1)
        for _ in range(20):
            assert space.contains(space.sample(mask=codec.unpack(observation)))


@pytest.mark.parametrize(
    ("name", "mask"),
    [
        ("Discrete", np.ones(3, np.int8)),
        ("Discrete", np.array([0, 1, 2, 0], np.int8)),
        ("Discrete", None),
        ("MultiDiscrete", ONES),
        ("MultiDiscrete", (ONES, ONES)),
        ("MultiDiscrete", 7),
        ("MultiBinary", np.array([0, 3, 1], np.int8)),
        ("nested", {"a": ONES}),
        ("Discrete", [[0, 1], [1]]),
        ("MultiDiscrete", ([0, [1]], ONES)),
        ("Box of floats", ONES),
    ],
)
def test_what_is_no_mask_of_the_space_is_refused(name: str, mask: Any) -> None:
    with pytest.raises(SimulatorError, match=r"no mask of|expected a dict"):
        MaskCodec(SPACES[name][0] if name in SPACES else spaces.Box(0, 1, (2,))).pack(mask)


class Watching(RandomAgent):
    """Plays at random, and records the masks."""

    def __init__(self) -> None:
        super().__init__(seed=1)
        self.seen: list[Observation] = []

    def agent_start(self, observation: Observation) -> Action:
        self.seen.append(observation)
        return super().agent_start(observation)

    def agent_step(self, reward: float, observation: Observation) -> Action:
        assert reward >= 1  # the second number has one legal value, and it is rewarded
        return self.agent_start(observation)


def test_gymnasiums_masks_reach_agents_if_they_are_asked_for() -> None:
    environment, agent = (
        make("gymnasium:tests/Masked-v0", action_mask=True, infos="step, path,worth"),
        Watching(),
    )
    assert capabilities(environment) == ("extras", "mask", "seed", "truncate")
    assert parse_task_spec(environment.env_init()).masks
    with local(agent, environment) as experiment:
        experiment.rl_init(1)
        first = experiment.rl_start().observation
        assert first.extras == {"step": 0, "path": ()}
        steps = [experiment.rl_step() for _ in range(4)]
    assert steps[-1].observation.mask is None  # no action is legal after the end
    assert steps[-1].observation.extras["worth"] == sum(step.reward for step in steps)
    assert steps[1].observation.extras == {"step": 2, "path": (0, 1)}
    assert len(agent.seen) == 4
    assert agent.seen[0].mask is not None
    assert agent.seen[0].mask[:5].tolist() == [True, True, False, True, False]
    assert not any(observation.extras for observation in agent.seen)


def test_without_being_asked_for_nothing_is_sent() -> None:
    environment = make("gymnasium:tests/Masked-v0")
    assert capabilities(environment) == ("seed", "truncate")
    environment.env_init()
    assert environment.env_start() == Observation([0])


def test_what_no_extra_may_be_is_refused_where_it_is_sent() -> None:
    with local(Watching(), make("gymnasium:tests/Masked-v0", infos="rich")) as experiment:
        experiment.rl_init(1)
        with pytest.raises(PeerFailed, match="the extra 'rich' must be a number, a text"):
            experiment.rl_start()
    with pytest.raises(ConfigError, match="have no masks"):
        glue.gym.GymnasiumEnvironment(lambda: gymnasium.make("tests/Unbounded-v0"), masks=True)


class Unbounded(gymnasium.Env[Any, Any]):  # type: ignore[misc]
    """Any int is an action."""

    observation_space = spaces.Discrete(2)
    action_space = spaces.Box(-(2**31), 2**31 - 1, (1,), np.int32)


gymnasium.register("tests/Unbounded-v0", entry_point=Unbounded)


def test_a_wrapped_environment_has_masks_and_extras_in_its_infos() -> None:
    env = glue.gym.wrap(make("gymnasium:tests/Masked-v0", action_mask=True, infos="step,path,worth"))
    assert (env.observation_space, env.action_space) == (spaces.Discrete(10), spaces.MultiDiscrete([3, 2]))
    _, info = env.reset(seed=1)
    assert plain(info["action_mask"]) == ([1, 1, 0], [1, 0])
    assert info["action_mask"][0].dtype == np.int8
    assert env.action_masks().tolist() == [True, True, False, True, False]
    env.action_space.seed(1)
    for step in range(1, 5):
        *_, terminated, _, info = env.step(env.action_space.sample(mask=info["action_mask"]))
        assert (info["step"], info["path"]) == (step, [*range(step)])
    assert terminated
    assert plain(info["action_mask"]) == ([1, 1, 1], [1, 1])
    assert info["worth"] >= 4
    env.close()


def test_extras_with_names_of_gymnasiums_own_are_called_otherwise() -> None:
    class Named(Counting):
        def _shown(self) -> Observation:
            return Observation([0], extras={"action_mask": 7, "episode": 8})

    env = gymnasium.wrappers.RecordEpisodeStatistics(glue.gym.wrap(Named(1)))
    env.reset()
    *_, info = env.step(np.array([0, 0]))
    assert (info["extra.action_mask"], info["extra.episode"], info["episode"]["r"]) == (7, 8, 1.0)
    assert plain(info["action_mask"]) == ([1, 1], [1, 1, 1])
    env.close()


def test_an_environment_without_masks_says_so() -> None:
    env = glue.gym.wrap(make("skeleton"))
    assert env.reset()[1] == {}
    with pytest.raises(SimulatorError, match="no masks"):
        env.action_masks()
    env.close()


class Counting(Environment):
    """One legal action at a time, of two numbers; an episode ends after `length` steps."""

    env_masks = env_extras = True

    def __init__(self, length: int) -> None:
        self._length = length

    def env_init(self) -> str:
        return task_spec(Discrete(99), Tuple(Discrete(2), Discrete(3)), extra="masks")

    def env_start(self) -> Observation:
        self._step = 0
        return self._shown()

    def env_step(self, action: Action) -> Step:
        assert action.ints.tolist() == [self._step % 2, self._step % 3]
        self._step += 1
        return Step(1.0, self._shown(), self._step == self._length)

    def _shown(self) -> Observation:
        mask = np.zeros(5, np.bool_)
        mask[[self._step % 2, 2 + self._step % 3]] = True
        extras: dict[str, Any] = {
            "step": self._step,
            "name": f"of {self._length}",
            "path": [*range(self._step)],
            "share": 1 if self._length == 2 else 0.5,
        }
        if self._step == self._length:
            extras["last"] = float(self._length)
        return Observation([self._step], mask=mask, extras=extras)


@pytest.mark.parametrize("mode", ["NextStep", "SameStep"])
def test_many_sessions_have_masks_and_extras_in_vector_form(mode: str) -> None:
    """Those of the last step survive the beginning of the next episode."""
    autoreset = pytest.importorskip("gymnasium.vector").AutoresetMode(mode)
    with hub_with({"short": Counting(2), "long": Counting(3)}) as hub:
        envs = glue.gym.connect_vec(hub, ["short", "long"], autoreset_mode=autoreset)
        _, infos = envs.reset()
        found = []
        for _ in range(3):
            actions = [[row.argmax() for row in mask] for mask in infos["action_mask"]]
            assert infos["_action_mask"].all()
            infos = envs.step(np.array(actions))[-1]
            found.append(infos)
        envs.close()
    first, second, third = found
    assert first["step"].tolist() == [1, 1]
    assert first["name"].tolist() == ["of 2", "of 3"]
    assert first["share"].tolist() == [1.0, 0.5]  # as a program in JavaScript sends it: 1 and 0.5
    assert "last" not in first
    if mode == "SameStep":
        assert second["step"].tolist() == [0, 2]
        assert second["final_info"]["last"].tolist() == [2.0, 0.0]
        assert second["final_info"]["_last"].tolist() == [True, False]
        assert second["final_info"]["path"][0] == [0, 1]
    else:
        assert second["step"].tolist() == [2, 2]
        assert (second["last"].tolist(), second["_last"].tolist()) == ([2.0, 0.0], [True, False])
        assert second["path"].tolist() == [[0, 1], [0, 1]]
        assert third["step"].tolist() == [0, 3]


def test_sarsa_learns_what_infos_allow() -> None:
    """In Taxi, most actions change nothing in most states; its infos say which do."""

    def returns(**options: bool) -> list[float]:
        agent: Agent = make_agent("sarsa", epsilon=0.05, step_size=0.4)
        with local(agent, make("gymnasium:Taxi-v4", max_episode_steps=100, **options)) as experiment:
            experiment.rl_init(1)
            return [total for total, _ in outcomes(experiment, 30)]

    assert sum(returns(action_mask=True)) > sum(returns()) + 3_000


def test_a_box_of_numbers_beside_masked_ones_has_no_mask() -> None:
    spec = task_spec(Discrete(2), Tuple(Box(0.0, 1.0), Discrete(2)), extra="masks")

    class Half(Counting):
        def env_init(self) -> str:
            return spec

        def _shown(self) -> Observation:
            return Observation([0], mask=[False, True])

    env = glue.gym.wrap(Half(1))
    _, info = env.reset()
    assert plain(info["action_mask"]) == {"doubles": None, "ints": [0, 1]}
    assert env.action_space.sample(mask=info["action_mask"])["ints"] == 1
    env.close()
