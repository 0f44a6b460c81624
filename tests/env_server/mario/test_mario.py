"""Infinite Mario as an environment: its options, calls, messages, and the state that outlives an episode."""

from __future__ import annotations

import hashlib
import struct
from typing import Any

import pytest

from env_server.mario.environment import InfiniteMario, State, pack_state
from glue import Action, Observation, SaveError, SimulatorError
from glue.options import build
from glue.roles import capabilities
from tests.agents.screens import TASK_SPEC
from tests.env_server.mario.golden_check import DIGESTS

Options = dict[str, Any]
RUN_RIGHT = Action(ints=[1, 0, 1])
JUMP_RIGHT = Action(ints=[1, 1, 1])
STAND = Action(ints=[0, 0, 0])


def begun(**options: Any) -> InfiniteMario:
    environment = InfiniteMario(**options)
    environment.env_init()
    environment.env_start()
    return environment


def play_to_the_end(environment: InfiniteMario, action: Action) -> tuple[float, Observation]:
    """Repeat an action; return the last reward and observation."""
    while True:
        reward, observation, ended, *_ = environment.env_step(action)
        if ended:
            return reward, observation


@pytest.mark.parametrize("known", DIGESTS["tasks"], ids=lambda known: str(known["options"]))
def test_published_task_plays_as_the_original(known: dict[str, Any]) -> None:
    """Two episodes of at most 400 fixed actions, against digests taken from the original."""
    environment = build(InfiniteMario, known["options"])
    environment.env_init()
    seen = hashlib.sha256()
    for expected_steps, expected_return in zip(known["steps"], known["returns"], strict=True):
        seen.update(packed(0.0, environment.env_start(), False))
        rewards: list[float] = []
        ended = False
        while not ended and len(rewards) < 400:
            i = len(rewards)
            action = Action(ints=[-1 if i % 23 >= 20 else 1, i % 7 < 4, i % 11 < 8])
            reward, observation, ended, *_ = environment.env_step(action)
            rewards.append(reward)
            seen.update(packed(reward, observation, ended))
        assert len(rewards) == expected_steps
        assert round(sum(rewards), 6) == expected_return
    assert seen.hexdigest()[:16] == known["digest"]


def packed(reward: float, observation: Observation, ended: bool) -> bytes:
    head = struct.pack("<d?", reward, ended)
    if ended:
        return head
    return head + observation.ints.tobytes() + observation.doubles.tobytes() + observation.chars


def test_task_spec_names_the_actions_and_the_reward_range() -> None:
    assert InfiniteMario().env_init() == TASK_SPEC


@pytest.mark.parametrize(
    ("value", "printed"),
    [
        (0.0, "0.0"),
        (9999999.0, "9999999.0"),
        (1e7, "1.0E7"),
        (123456789.0, "1.23456789E8"),
        (1e8 / 3, "3.3333333333333332E7"),
        (0.001, "0.001"),
        (0.00025, "2.5E-4"),
    ],
)
def test_task_spec_prints_numbers_as_java_does(value: float, printed: str) -> None:
    spec = InfiniteMario(reward_goal=value, reward_death=-1, reward_coin=-1, reward_kill=-1).env_init()
    assert spec.endswith(f"REWARDS (-1.0 {printed})")


def test_single_parameter_overrides_the_instance_and_the_mdp() -> None:
    assert InfiniteMario(instance=5).parameters.speed_walk == 0.3
    assert InfiniteMario(instance=5, speed_walk=0.5).parameters.speed_walk == 0.5
    assert InfiniteMario(mdp="testing-9").parameters.level_seed == 2299321
    assert InfiniteMario(mdp="testing-9", level_seed=7).parameters.level_seed == 7
    assert InfiniteMario(mdp="testing-9", level_seed=7).parameters.level_type == 2


@pytest.mark.parametrize(
    ("options", "bound"),
    [
        ({"level_type": 3}, "from 0 to 2, not 3"),
        ({"instance": 3, "mdp": "proving-1"}, "instance 3 and mdp proving-1 are two tasks: leave out one"),
        ({"speed_walk": float("nan")}, "not nan"),
        ({"start_ticks": 7}, "5 or 10 ticks, not 7"),
        ({"render": "sometimes"}, "tick, checkin, not 'sometimes'"),
        ({"jump_time": 7.5}, "takes a whole number, not 7.5"),
    ],
)
def test_parameter_out_of_bounds_is_refused_with_the_bound(options: Options, bound: str) -> None:
    with pytest.raises(SimulatorError, match=bound.replace(".", r"\.")) as refused:
        InfiniteMario(**options)
    assert next(iter(options)) in str(refused.value)


@pytest.mark.parametrize(
    ("action", "complaint"),
    [
        (Action(ints=[2, 0, 0]), "direction must be from -1 to 1, not 2"),
        (Action(ints=[-2, 0, 2]), "direction must be from -1 to 1, not -2; run must be from 0 to 1, not 2"),
        (Action(ints=[0, 0]), "2 ints, 0 doubles and 0 chars"),
        (Action(ints=[0, 0, 0], doubles=[1.0]), "3 ints, 1 doubles and 0 chars"),
    ],
)
def test_action_out_of_bounds_is_refused_and_changes_nothing(action: Action, complaint: str) -> None:
    environment = begun()
    with pytest.raises(SimulatorError, match=complaint):
        environment.env_step(action)
    assert environment.env_step(RUN_RIGHT) == begun().env_step(RUN_RIGHT)


def test_calls_out_of_place_are_refused() -> None:
    environment = InfiniteMario(max_trial_steps=1)
    with pytest.raises(SimulatorError, match="env_init"):
        environment.env_start()
    environment.env_init()
    with pytest.raises(SimulatorError, match="start"):
        environment.env_step(STAND)
    environment.env_start()
    assert environment.env_step(STAND)[2]
    with pytest.raises(SimulatorError, match="start"):
        environment.env_step(STAND)
    environment.env_cleanup()
    with pytest.raises(SimulatorError, match="env_init"):
        environment.env_start()


def test_standing_still_times_out_with_the_last_observation() -> None:
    environment = begun(level_seed=3, max_trial_steps=20)
    last = None
    for _ in range(19):
        _, last, ended, *_ = environment.env_step(STAND)
        assert not ended
    assert environment.env_step(STAND)[:3] == (-10.0, last, True)


def test_buttons_held_at_the_end_move_the_next_episode() -> None:
    environment = begun(max_trial_steps=5)
    play_to_the_end(environment, RUN_RIGHT)
    # Mario died in the first tick of a step, which releases run but not right.
    assert environment.env_start().doubles[0] == 2.0708749294281006
    play_to_the_end(environment, STAND)
    assert environment.env_start().doubles[0] == 2.0


def test_save_brings_back_what_later_episodes_depend_on() -> None:
    environment = begun(max_trial_steps=5, start_ticks=10)
    environment.env_message("level level_seed=8 level_type=2 level_difficulty=5")
    play_to_the_end(environment, JUMP_RIGHT)
    saved = environment.env_save()
    expected = environment.env_start()
    other = InfiniteMario(max_trial_steps=5, start_ticks=10)
    other.env_init()
    other.env_load(saved)
    assert other.env_message("level") == "level_seed=8 level_type=2 level_difficulty=5"
    assert other.env_start() == expected
    assert other.env_step(JUMP_RIGHT) == environment.env_step(JUMP_RIGHT)
    assert capabilities(environment) == ("save", "truncate")


def test_save_with_a_level_out_of_bounds_is_refused() -> None:
    environment = begun()
    with pytest.raises(SaveError, match="level_type must be from 0 to 2, not 3"):
        environment.env_load(pack_state(State((121, 3, 0), (False,) * 4, False)))
    assert environment.env_message("level") == "level_seed=121 level_type=0 level_difficulty=0"


def test_save_of_an_earlier_version_is_read_and_checked() -> None:
    old = bytes.fromhex("6d6172696f000001080000000000000002000000050000000001000001bacc2a31")
    environment = begun(max_trial_steps=5)
    environment.env_load(old)
    assert environment.env_message("level") == "level_seed=8 level_type=2 level_difficulty=5"
    assert environment.buttons == (False, True, False, False)
    for i in range(len(old)):
        with pytest.raises(SaveError):
            environment.env_load(old[:i] + bytes([old[i] ^ 1]) + old[i + 1 :])


def test_level_changed_by_message_counts_from_the_next_episode() -> None:
    environment = begun()
    untouched = begun()
    answer = environment.env_message("level level_seed=5 level_type=1")
    assert answer == "level_seed=5 level_type=1 level_difficulty=0"
    assert environment.env_step(RUN_RIGHT) == untouched.env_step(RUN_RIGHT)
    assert environment.env_start().chars == begun(level_seed=5, level_type=1).env_start().chars
    environment.env_cleanup()
    assert environment.env_message("level") == "level_seed=121 level_type=0 level_difficulty=0"


@pytest.mark.parametrize(
    "message", ["", "parameters please", "level level_seed=five", "level level_type=3", "level speed_walk=1"]
)
def test_other_messages_are_refused_and_change_nothing(message: str) -> None:
    environment = begun()
    before = environment.parameters
    assert environment.env_message(message).startswith("refused: ")
    assert environment.parameters == before
