"""Infinite Mario in Gymnasium: as recorded from the original, and as in Gymnasium's own vectors of games."""

from __future__ import annotations

import hashlib
import os
import warnings
from dataclasses import asdict
from typing import Any

import numpy as np
import pytest

from env_server.mario.observation import BODY_SIZE
from env_server.mario.parameters import Parameters
from glue import ConfigError, Observation, SimulatorError
from tests.env_server.mario import golden_check

gymnasium: Any = pytest.importorskip("gymnasium", reason="needs Gymnasium: the extra gym")
checker: Any = pytest.importorskip("gymnasium.utils.env_checker")
vector: Any = pytest.importorskip("gymnasium.vector")

ID = "env_server.gym:glue/InfiniteMario-v0"
STEPS = int(os.environ.get("GYM_STEPS", "4000"))
"""Steps of all games together; .ci/run plays 100,000."""
GAMES = 64
VIEWS = ("tiles", "planes", "pixels", "raw")


def make(**options: Any) -> Any:
    return gymnasium.make(ID, **options)


def begun(seed: int = 0, **options: Any) -> Any:
    """Return a game in its first episode."""
    env = make(**options)
    env.reset(seed=seed)
    return env


def make_vec(count: int = GAMES, **options: Any) -> Any:
    return gymnasium.make_vec(ID, num_envs=count, **options)


def rows(observation: Any) -> list[bytes]:
    """Return an observation, of one game or of many, as bytes."""
    if isinstance(observation, dict):
        return [part.tobytes() for _, part in sorted(observation.items())]
    return [observation.tobytes()]


def assert_equal(ours: Any, theirs: Any) -> None:
    """Compare return values of vector environments to the last byte, nested like infos."""
    if isinstance(theirs, dict):
        assert ours.keys() == theirs.keys()
        for name in theirs:
            assert_equal(ours[name], theirs[name])
    elif isinstance(theirs, np.ndarray) and theirs.dtype == object:
        for one, other in zip(ours, theirs, strict=True):
            assert_equal(one, other)
    elif theirs is None:
        assert ours is None
    else:
        assert ours.dtype == theirs.dtype
        assert ours.shape == theirs.shape
        assert ours.tobytes() == theirs.tobytes()


def lively(generator: np.random.Generator, count: int) -> np.ndarray:
    """Return actions that mostly run to the right."""
    direction = generator.choice(3, count, p=[0.1, 0.1, 0.8])
    return np.stack([direction, generator.integers(0, 2, count), generator.integers(0, 2, count)], 1)


@pytest.mark.parametrize("view", VIEWS)
def test_check_env_finds_nothing_but_infinite_bounds(view: str) -> None:
    env = make(observation=view, render_mode="rgb_array").unwrapped
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        checker.check_env(env)
    assert all("infinity" in str(warning.message) for warning in caught)


@pytest.mark.skipif(not hasattr(vector, "AutoresetMode"), reason="Gymnasium 1.0 has no modes to compare with")
@pytest.mark.parametrize("levels", [{"levels": "train-200"}, {"num_levels": GAMES}], ids=["own", "shared"])
@pytest.mark.parametrize(
    ("mode", "view"),
    [("NextStep", "tiles"), ("SameStep", "planes"), ("SameStep", "pixels"), ("Disabled", "raw")],
)
def test_vector_environment_is_as_gymnasium_puts_single_ones_together(
    mode: str, view: str, levels: dict[str, Any]
) -> None:
    options: dict[str, Any] = {"observation": view, "max_trial_steps": 90, **levels}
    ours = make_vec(autoreset_mode=mode, num_threads=2, max_episode_steps=60, **options)
    singles = [lambda: make(max_episode_steps=60, **options)] * GAMES
    theirs = vector.SyncVectorEnv(singles, autoreset_mode=vector.AutoresetMode(mode))
    assert ours.metadata["autoreset_mode"] is theirs.metadata["autoreset_mode"]
    assert ours.observation_space == theirs.observation_space
    assert ours.action_space == theirs.action_space
    generator = np.random.default_rng(7)
    assert_equal(ours.reset(seed=7)[1], theirs.reset(seed=7)[1])
    ends = 0
    for _ in range(STEPS // GAMES):
        actions = lively(generator, GAMES)
        mine, other = ours.step(actions), theirs.step(actions)
        for part, expected in zip(mine, other, strict=True):
            assert_equal(part, expected)
        over = mine[2] | mine[3]
        ends += over.sum()
        if mode == "Disabled" and over.any():
            mask = {"reset_mask": over}
            mine, other = ours.reset(options=dict(mask)), theirs.reset(options=dict(mask))
            assert_equal(mine[0], other[0])
            for name in other[1]:
                assert_equal(mine[1][name], other[1][name])
    assert ends > GAMES // 2
    ours.close()
    theirs.close()


def as_recorded(shown: dict[str, Any]) -> Observation:
    """Return an observation of the raw view as RL-Glue's."""
    actors = int(shown["actors"][0])
    return Observation(
        shown["ints"][: 1 + 2 * actors], shown["doubles"][: 4 * actors], shown["chars"].tobytes()
    )


class Single:
    """A single environment, played as a `Game`."""

    def __init__(self, parameters: Parameters) -> None:
        self._env = make(observation="raw", **asdict(parameters))
        self._seed: int | None = 0

    def start(self) -> Observation:
        shown, _ = self._env.reset(seed=self._seed)
        self._seed = None
        return as_recorded(shown)

    def step(self, *action: int) -> tuple[float, Observation, bool]:
        shown, reward, ended, _, _ = self._env.step(np.array([action[0] + 1, *action[1:]]))
        return reward, as_recorded(shown), ended


def test_what_the_original_recorded_is_played() -> None:
    for name, least in (("variants", 697), ("episodes", min(STEPS, 20_000))):
        compared, differences = golden_check.check_runs(name, play=Single, most=STEPS)
        assert differences == []
        assert compared >= least


def test_views_show_what_the_raw_observation_says() -> None:
    envs = {view: begun(1, observation=view, level_difficulty=3) for view in VIEWS}
    generator = np.random.default_rng(1)
    for _ in range(150):
        action = lively(generator, 1)[0]
        outcomes = {view: env.step(action) for view, env in envs.items()}
        if outcomes["raw"][2]:
            for env in envs.values():
                env.reset()
            continue
        shown = {view: outcome[0] for view, outcome in outcomes.items()}
        raw = as_recorded(shown["raw"])
        codes = np.frombuffer(raw.chars, np.uint8).reshape(16, 22)[:, :21]
        tiles = shown["tiles"]["tiles"]
        assert bytes(b" 1237b?|$!M"[code] for code in tiles.ravel()) == codes.tobytes()
        kinds, places = raw.ints[1:].reshape(-1, 2), raw.doubles.reshape(-1, 4)
        sprites = shown["tiles"]["sprites"]
        count = len(kinds)
        assert sprites[:, 0].tolist() == [1.0] * count + [0.0] * (16 - count)
        assert sprites[0, 1:].tolist() == pytest.approx([*kinds[0], *(places[0, :2] % 1), *places[0, 2:]])
        offsets = places[1:, :2] - places[0, :2]
        order = np.argsort(np.hypot(*offsets.T), kind="stable")
        expected = np.column_stack([kinds[1:], offsets, places[1:, 2:]])[order]
        np.testing.assert_allclose(sprites[1:count, 1:], expected, rtol=1e-6, atol=1e-6)
        planes = shown["planes"]
        for code in range(1, 11):
            assert (planes[code - 1] == (tiles == code)).all()
        cells = {
            (int(kind), 15 - int(np.floor(y)), int(np.floor(x)) - raw.ints[0])
            for kind, (x, y) in zip(kinds[1:, 0], places[1:, :2], strict=True)
        }
        seen = {(kind, r, c) for kind, r, c in cells if 0 <= r < 16 and 0 <= c < 21}
        assert {(p - 9, r, c) for p, r, c in np.argwhere(planes[:19]).tolist() if p > 9} == seen


def test_pictures_are_the_same_to_the_byte_in_two_threads_and_stay_as_they_were() -> None:
    """Threads copy pictures themselves if there are many: 24 of them are enough."""
    generator = np.random.default_rng(0)
    one, two = (
        make_vec(24, observation="pixels", num_levels=9, autoreset_mode="SameStep", num_threads=threads)
        for threads in (1, 2)
    )
    shown = [(one.reset(seed=0)[0], two.reset(seed=0)[0])]
    for _ in range(80):
        action = generator.integers([1, 0, 0], [3, 2, 2], (24, 3))
        shown.append((one.step(action)[0], two.step(action)[0]))
    assert all((ours == theirs).all() for ours, theirs in shown)
    pictures = np.stack([ours for ours, _ in shown])
    assert hashlib.sha256(pictures.tobytes()).hexdigest()[:16] == "bcbfd55e0daeddf9"


def test_seeded_reset_forgets_and_an_unseeded_one_keeps_the_buttons() -> None:
    env = make(max_trial_steps=3, start_ticks=5)
    first = rows(env.reset(seed=5)[0])
    for _ in range(2):
        for _ in range(3):
            *_, terminated, _, _ = env.step(np.array([2, 1, 1]))
        assert terminated
        kept = rows(env.reset()[0])
    assert kept != first
    assert rows(env.reset(seed=5)[0]) == first


def test_levels_of_a_set_depend_on_the_seed_alone() -> None:
    def played(seed: int, steps: int) -> list[int]:
        env = make(levels="train-200", max_trial_steps=steps)
        seeds = []
        _, info = env.reset(seed=seed)
        for _ in range(20):
            seeds.append(info["level_seed"])
            while not env.step(env.unwrapped.action_space.sample())[2]:
                pass
            _, info = env.reset()
        return seeds

    assert played(1, 1) == played(1, 2) != played(2, 1)
    assert len(set(played(1, 1))) > 15


def test_step_limit_of_mario_terminates_and_that_of_gymnasium_truncates() -> None:
    ours, gymnasiums = begun(max_trial_steps=4), begun(max_episode_steps=4)
    outcomes = [[env.step(np.array([1, 0, 0])) for _ in range(4)] for env in (ours, gymnasiums)]
    assert [outcome[4]["timeout"] for outcome in outcomes[0]] == [False, False, False, True]
    assert outcomes[0][-1][1:4] == (-10.0, True, False)
    assert outcomes[1][-1][2:4] == (False, True)
    assert outcomes[1][-1][4]["timeout"] is False


def test_death_is_no_timeout_and_the_goal_is_told() -> None:
    env = begun(level_difficulty=10)
    for step in range(999):
        *_, terminated, _, info = env.step(np.array([2, step // 2 % 2, 0]))
        if terminated:
            break
    assert (info["timeout"], info["goal"]) == (False, False)
    env = begun(level_seed=121, level_width=0)
    for _ in range(200):
        _, reward, terminated, _, info = env.step(np.array([2, 1, 1]))
        if terminated:
            break
    assert (reward, info["timeout"], info["goal"]) == (100.0, False, True)


def test_state_can_be_cloned_and_restored() -> None:
    env = begun(2, levels="train-200", max_trial_steps=40).unwrapped
    generator = np.random.default_rng(2)
    for _ in range(10):
        env.step(lively(generator, 1)[0])
    state = env.clone_state()
    actions = lively(generator, 60)

    def future() -> list[Any]:
        seen: list[Any] = []
        for action in actions:
            shown, reward, terminated, _, info = env.step(action)
            seen.append((rows(shown), reward, terminated, info))
            if terminated:
                shown, info = env.reset()
                seen.append((rows(shown), info))
        return seen

    first = future()
    env.restore_state(state)
    assert future() == first
    with pytest.raises(SimulatorError, match="another kind of observation"):
        make(observation="pixels").unwrapped.restore_state(state)


@pytest.mark.parametrize("action", ["buttons", "discrete"])
def test_an_action_outside_the_space_is_refused_and_nothing_moves(action: str) -> None:
    env = begun(action=action).unwrapped
    envs = make_vec(2, action=action)
    envs.reset(seed=0)
    before = env.clone_state()
    good = env.action_space.sample()
    wrongs: list[Any] = [99, -1, 1.5, [3, 0, 0], [0, 2, 0], [1] * 4, "jump", None, [[1, 0, 0]], np.nan]
    for wrong in wrongs:
        with pytest.raises(SimulatorError):
            env.step(wrong)
        with pytest.raises(SimulatorError):
            envs.step([good, wrong] if np.shape(wrong) == np.shape(good) else wrong)
    single, several = ([3, 0, 0], [[1, 0, 0], [3, 0, 0]]) if action == "buttons" else (12, [0, 12])
    with pytest.raises(SimulatorError, match=r"received (\[3, 0, 0\]|12)$"):
        env.step(single)
    with pytest.raises(SimulatorError, match=r"received (\[3, 0, 0\]|12) for game 1$"):
        envs.step(several)
    for ours, theirs in zip(env.clone_state().arrays, before.arrays, strict=True):
        assert ours.tobytes() == theirs.tobytes()
    shown = envs.step(np.stack([good, good]))[0]
    expected = rows(env.step(good)[0])
    assert rows({name: part[0] for name, part in shown.items()}) == expected
    assert rows({name: part[1] for name, part in shown.items()}) == expected


def test_discrete_actions_are_the_buttons_in_order() -> None:
    for number in range(12):
        one, other = begun(action="discrete"), begun()
        for _ in range(5):
            shown = one.step(number)[0]
            expected = other.step(np.array([number // 4, number // 2 % 2, number % 2]))[0]
        assert rows(shown) == rows(expected)


def test_copies_are_fresh_and_views_are_not() -> None:
    for copy in (True, False):
        envs = make_vec(2, copy=copy)
        first, _ = envs.reset(seed=0)
        before = first["sprites"].copy()
        envs.step(np.array([[2, 0, 1]] * 2))
        assert (first["sprites"] == before).all() == copy


def test_what_cannot_be_is_refused_by_name() -> None:
    for options, message in (
        ({"observation": "tile"}, "observation is one of"),
        ({"observation": ["tiles"]}, "observation is one of"),
        ({"action": "joystick"}, "action is one of"),
        ({"action": ["buttons"]}, "action is one of"),
        ({"levels": "train-20"}, "did you mean"),
        ({"levels": "train-200", "num_levels": 3}, "leave out num_levels"),
        ({"start_level": 3}, "needs num_levels"),
        ({"num_levels": 0}, "num_levels must be"),
        ({"num_levels": "3"}, "num_levels takes a whole number"),
        ({"levels": ["train-200"]}, "no set of levels is called"),
        ({"levels": "train-200", "level_seed": 3}, "level_seed is one level"),
        ({"level_dificulty": 1}, "no option level_dificulty"),
        ({"level_type": 7}, "level_type must be"),
    ):
        for maker in (make, make_vec):
            with pytest.raises((ConfigError, SimulatorError), match=message):
                maker(**options)
    for options, message in (
        ({"autoreset_mode": "Never"}, "autoreset_mode is one of"),
        ({"num_threads": 0}, "num_threads must be"),
        ({"render_mode": "human"}, "many games have no window"),
        ({"max_episode_steps": 0}, "max_episode_steps must be"),
    ):
        with pytest.raises(ConfigError, match=message):
            make_vec(**options)
    envs = make_vec(2)
    envs.reset(seed=0)
    with pytest.raises(ConfigError, match="reset_mask"):
        envs.reset(options={"reset_mask": np.zeros(2, np.bool_)})
    with pytest.raises(ConfigError, match="a seed for each"):
        envs.reset(seed=[1])
    with pytest.raises(SimulatorError, match="clone_state"):
        make().unwrapped.restore_state(None)


def test_numbers_may_be_those_of_numpy() -> None:
    numpys, pythons = (
        make_vec(3, num_levels=kind(40), start_level=kind(7), max_trial_steps=kind(50))
        for kind in (np.int64, int)
    )
    for seed, same in ((np.int64(3), 3), (np.arange(3), [0, 1, 2])):
        for part, expected in zip(numpys.reset(seed=seed), pythons.reset(seed=same), strict=True):
            assert_equal(part, expected)


def test_ended_games_need_a_reset_where_it_is_not_automatic() -> None:
    envs = make_vec(2, autoreset_mode="Disabled", max_episode_steps=1)
    with pytest.raises(SimulatorError, match="game 0 has no episode"):
        envs.step(np.array([[1, 0, 0]] * 2))
    envs.reset(seed=0)
    envs.step(np.array([[1, 0, 0]] * 2))
    envs.reset(options={"reset_mask": np.array([True, False])})
    with pytest.raises(SimulatorError, match="game 1 has no episode"):
        envs.step(np.array([[1, 0, 0]] * 2))


def test_renders_pixels_and_text_and_says_what_a_window_needs(monkeypatch: pytest.MonkeyPatch) -> None:
    assert begun(render_mode="rgb_array").render().shape == (240, 320, 3)
    assert "tiles/step" in begun(render_mode="ansi").render()
    assert len(make_vec(3, render_mode="rgb_array").unwrapped.metadata["render_modes"]) == 2
    monkeypatch.delenv("DISPLAY", raising=False)
    with pytest.raises(ConfigError, match="render_mode='rgb_array'"):
        begun(render_mode="human")


def test_raw_view_has_room_for_every_observation() -> None:
    space = make(observation="raw").observation_space
    size = 16 + 8 * space["doubles"].shape[0] + 4 * space["ints"].shape[0] + 352
    assert BODY_SIZE - 8 < size <= BODY_SIZE
