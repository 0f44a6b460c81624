"""The hierarchical agents: SARSA by hand at both levels, preferences, interruptions, internal rewards."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pytest

from agents.mario.agent import ACTIONS, RIGHT, action_number
from agents.mario.objects import A_COIN, A_MONSTER, A_QUESTION, STATIONARY
from agents.mario.observation import GOOMBA
from agents.mohan2010.flo import CONTEXT, FLO_LEVEL, KLO_LEVEL
from agents.mohan2010.hierarchical import (
    HierarchicalAgent,
    HierarchicalFactsAgent,
    HierarchicalInternalAgent,
    HierarchicalProgrammedAgent,
    ObjectsCoarseAgent,
)
from glue.saves import Saved, pack
from glue.types import Action
from tests.agents.screens import TASK_SPEC, draw, key, learned

GROUND = "7" * 21
THREAT, QUESTION, COIN = 1, 2, 4  # the bits of the context
WALK = ACTIONS[action_number(RIGHT, False, False)]
JUMP = ACTIONS[action_number(RIGHT, True, False)]
RUNNING_JUMP = ACTIONS[action_number(RIGHT, True, True)]


def begun(agent: HierarchicalAgent, seed: int = 1) -> HierarchicalAgent:
    agent.agent_seed(seed)
    agent.agent_init(TASK_SPEC)
    return agent


def number(action: Action) -> int:
    return ACTIONS.index(action)


def teach(agent: HierarchicalAgent, values: Mapping[int, float]) -> None:
    """Make an agent load these values."""
    keys = sorted(values)
    arrays = {"keys": np.array(keys, np.uint64), "values": np.array([values[key] for key in keys])}
    agent.agent_load(
        pack(Saved(agent.name, {"grid": 2, "tile_above": False}, {"random": 1, "cycles": 0}, arrays))
    )


# Learning


def test_a_visit_to_a_coin_by_hand() -> None:
    """Three steps towards a coin, which is then taken; a step of move-to-goal; another coin; death."""
    agent = begun(HierarchicalAgent(epsilon=0.0))
    far = draw("  $", "", " M", GROUND)
    near = draw("  $", " M", "", GROUND)
    nothing = draw("  M", "", "", GROUND)
    another = draw("   $", "", "  M", GROUND)

    def of_klo(dy: int, action: Action) -> int:
        return key(KLO_LEVEL, A_COIN, 0, 1, dy, 0, 0, number(action))

    of_flo, of_context = key(FLO_LEVEL, A_COIN, 0, 1, 2, 0), key(CONTEXT, A_COIN, COIN)

    first = agent.agent_start(far)
    assert learned(agent) == {}

    second = agent.agent_step(-0.01, near)
    assert learned(agent) == {of_klo(2, first): pytest.approx(0.3 * (-0.01 + 0.9 * 0))}

    third = agent.agent_step(-0.01, near)
    assert third != second
    expected = {of_klo(2, first): -0.003, of_klo(1, second): -0.003}
    assert learned(agent) == pytest.approx(expected)

    # The coin is gone, so the visit is over: the last KLO is not bootstrapped.
    assert agent.agent_step(1.0, nothing) == WALK
    expected[of_klo(1, third)] = 0.3 * 1.0
    assert learned(agent) == pytest.approx(expected)

    # The previous FLO has earned 0.98, and 0.9 of a step's cost across the gap; its object and its
    # context share the update.
    last = agent.agent_step(-0.01, another)
    assert last != first
    expected[of_flo] = expected[of_context] = 0.15 * (0.98 - 0.9 * 0.01)
    assert learned(agent) == pytest.approx(expected)

    # Death reaches both levels.
    agent.agent_end(-10.0)
    expected[of_klo(2, last)] = 0.3 * -10.0
    value = expected[of_flo] + expected[of_context]
    expected[of_flo] = expected[of_context] = value / 2 + 0.15 * (-10.0 - value)
    assert learned(agent) == pytest.approx(expected)


def test_the_next_klos_value_is_bootstrapped_within_an_flo_only() -> None:
    agent = begun(HierarchicalAgent(epsilon=0.0))
    before, after, other = (
        key(KLO_LEVEL, A_COIN, 0, 1, 1, 0, 0, 3),
        key(KLO_LEVEL, A_COIN, 0, 0, 1, 0, 0, 5),
        key(KLO_LEVEL, A_COIN, 0, -1, 3, 0, 0, 7),
    )
    teach(agent, {before: 1.0, after: 2.0, other: 4.0})
    assert number(agent.agent_start(draw(" $", "M", GROUND))) == 3
    assert number(agent.agent_step(-0.01, draw(" $", " M", GROUND))) == 5
    assert learned(agent)[before] == pytest.approx(1.0 + 0.3 * (-0.01 + 0.9 * 2.0 - 1.0))
    # The next coin is a different one, so its FLO is a new visit.
    assert number(agent.agent_step(1.0, draw("$", "", "", " M", GROUND))) == 7
    assert learned(agent)[after] == pytest.approx(2.0 + 0.3 * (1.0 - 2.0))


def test_the_flo_level_bootstraps_across_unlearned_flos() -> None:
    """Two selections of unlearned FLOs, a pit and then move-to-goal, discount the later rewards."""
    agent = begun(HierarchicalProgrammedAgent(epsilon=0.0))
    coin, question = key(FLO_LEVEL, A_COIN, 0, 1, 1, 0), key(FLO_LEVEL, A_QUESTION, 0, 2, 3, 0)
    teach(agent, {coin: 1.0, question: 5.0})
    agent.agent_start(draw(" $", "M", GROUND))
    assert agent.agent_step(2.0, draw("M", "77  77777")) == RUNNING_JUMP
    assert agent.agent_step(3.0, draw("   M", "77  77777")) == RUNNING_JUMP
    assert agent.agent_step(4.0, draw("    M", GROUND)) == WALK
    assert agent.agent_step(5.0, draw("     M", GROUND)) == WALK
    agent.agent_step(6.0, draw("     ?", "", "", "   M", GROUND))
    total = 2.0 + 0.9 * (3.0 + 4.0) + 0.81 * (5.0 + 6.0)
    assert learned(agent)[coin] == pytest.approx(1.0 + 0.3 * (total + 0.9**3 * 5.0 - 1.0))


def test_an_flo_that_follows_at_once_is_discounted_once() -> None:
    agent = begun(HierarchicalProgrammedAgent(epsilon=0.0))
    coin, question = key(FLO_LEVEL, A_COIN, 0, 1, 1, 0), key(FLO_LEVEL, A_QUESTION, 0, 2, 3, 0)
    teach(agent, {coin: 1.0, question: 5.0})
    agent.agent_start(draw(" $", "M", GROUND))
    agent.agent_step(2.0, draw(" $", "M", GROUND))
    agent.agent_step(3.0, draw("  ?", "", "", "M", GROUND))
    assert learned(agent)[coin] == pytest.approx(1.0 + 0.3 * (5.0 + 0.9 * 5.0 - 1.0))


def test_the_finish_line_is_earned_by_the_flo_before_move_to_goal() -> None:
    agent = begun(HierarchicalProgrammedAgent(epsilon=0.0))
    agent.agent_start(draw(" $", "M", GROUND))
    agent.agent_step(1.0, draw(" M", GROUND))
    agent.agent_end(100.0)
    assert learned(agent)[key(FLO_LEVEL, A_COIN, 0, 1, 1, 0)] == pytest.approx(0.3 * (1.0 + 0.9 * 100.0))


def test_an_interrupted_flo_is_updated_with_its_reward_alone() -> None:
    """A monster interrupts the FLO of a coin if the order is programmed; learned FLOs run to their end."""
    calm = draw(" $", "M", GROUND)
    threat = draw(" $", "M", GROUND, monsters=[(GOOMBA, 2.5, 1.0, 0.0, 0.0)])
    coin = [key(KLO_LEVEL, A_COIN, 0, 1, 1, 0, 0, action) for action in range(12)]
    monster = [key(KLO_LEVEL, A_MONSTER, GOOMBA, 4, 0, STATIONARY, 0, action) for action in range(12)]

    for kind, interrupted in ((HierarchicalProgrammedAgent, True), (HierarchicalAgent, False)):
        agent = begun(kind(epsilon=0.0))
        teach(agent, dict.fromkeys(coin, 2.0) | dict.fromkeys(monster, 7.0))
        first = number(agent.agent_start(calm))
        second = number(agent.agent_step(-0.01, threat))
        bootstrapped = 0.0 if interrupted else 0.9 * 2.0
        assert learned(agent)[coin[first]] == pytest.approx(2.0 + 0.3 * (-0.01 + bootstrapped - 2.0))
        agent.agent_end(-10.0)
        updated = monster if interrupted else coin
        before = 7.0 if interrupted else 2.0
        if second != first or interrupted:
            assert learned(agent)[updated[second]] == pytest.approx(before + 0.3 * (-10.0 - before))


def test_a_cut_off_episode_teaches_nothing_more() -> None:
    agent = begun(HierarchicalAgent())
    agent.agent_start(draw(" $", "M", GROUND))
    agent.agent_start(draw(" $", "M", GROUND))
    agent.agent_start(draw("M", GROUND))
    assert learned(agent) == {}
    agent.agent_end(-10.0)
    assert learned(agent) == {}


def test_without_learning_neither_values_nor_epsilon_change() -> None:
    agent = begun(HierarchicalAgent(learning=False))
    known = {key(KLO_LEVEL, A_COIN, 0, 1, 1, 0, 0, 4): 1.0}
    teach(agent, known)
    agent.agent_start(draw(" $", "M", GROUND))
    for _ in range(20):
        agent.agent_step(-5.0, draw(" $", "M", GROUND))
    agent.agent_end(-10.0)
    assert learned(agent) == known
    assert agent.agent_message("epsilon") == "0.1"


def test_epsilon_shrinks_by_three_cycles_when_an_flo_opens_and_by_one_while_it_lasts() -> None:
    agent = begun(HierarchicalAgent(epsilon=0.5, reduction=0.5))
    coin, nothing = draw(" $", "M", GROUND), draw("M", GROUND)
    cycles = 0
    agent.agent_start(coin)
    for screen, more in ((coin, 3), (coin, 1), (nothing, 1), (nothing, 3), (coin, 1)):
        cycles += more
        assert float(agent.agent_message("epsilon")) == 0.5 * 0.5**cycles
        agent.agent_step(0.0, screen)
    agent.agent_end(-10.0)
    assert float(agent.agent_message("epsilon")) == 0.5 * 0.5 ** (cycles + 3)
    agent.agent_start(nothing)
    assert float(agent.agent_message("epsilon")) == 0.5 * 0.5 ** (cycles + 6)


# Choosing


def test_move_to_goal_walks_and_jumps_where_something_is_in_the_way() -> None:
    agent = begun(HierarchicalAgent())
    assert agent.agent_start(draw("M", GROUND)) == WALK
    assert agent.agent_step(0.0, draw("M7", GROUND)) == JUMP
    assert agent.agent_step(0.0, draw("M|", GROUND)) == JUMP
    assert agent.agent_step(0.0, draw("M1", GROUND)) == WALK


def test_a_pit_comes_before_everything_else() -> None:
    screen = draw(" $?", "M", "77  77777", monsters=[(GOOMBA, 1.5, 1.0, 0.0, 0.0)])
    for kind in (HierarchicalAgent, HierarchicalProgrammedAgent):
        agent = begun(kind(epsilon=1.0, reduction=1.0))
        assert agent.agent_start(screen) == RUNNING_JUMP


@pytest.mark.parametrize(
    ("rows", "monsters", "chosen"),
    [
        ((" $?", "M", GROUND), True, A_MONSTER),
        ((" $?", "M", GROUND), False, A_QUESTION),
        ((" $", "M", GROUND), False, A_COIN),
    ],
)
def test_the_programmed_order_is_monster_question_coin(
    rows: tuple[str, ...], monsters: bool, chosen: int
) -> None:
    """The order does not depend on the values, which here are in the opposite order."""
    flos = {
        A_MONSTER: key(FLO_LEVEL, A_MONSTER, GOOMBA, 6, 0, STATIONARY),
        A_QUESTION: key(FLO_LEVEL, A_QUESTION, 0, 2, 1, 0),
        A_COIN: key(FLO_LEVEL, A_COIN, 0, 1, 1, 0),
    }
    values = {flos[A_MONSTER]: -3.0, flos[A_QUESTION]: -2.0, flos[A_COIN]: -1.0}
    screen = draw(*rows, monsters=[(GOOMBA, 3.5, 1.0, 0.0, 0.0)] if monsters else ())
    agent = begun(HierarchicalProgrammedAgent(epsilon=0.0))
    teach(agent, values)
    agent.agent_start(screen)
    agent.agent_end(0.0)
    changed = {flo for flo in values if learned(agent)[flo] != values[flo]}
    assert changed == {flos[chosen]}


@pytest.mark.parametrize("best", [A_MONSTER, A_QUESTION, A_COIN])
def test_learned_selection_follows_the_values_of_object_and_context(best: int) -> None:
    screen = draw(" $?", "M", GROUND, monsters=[(GOOMBA, 3.5, 1.0, 0.0, 0.0)])
    agent = begun(HierarchicalAgent(epsilon=0.0))
    context = {kind: key(CONTEXT, kind, THREAT | QUESTION | COIN) for kind in (A_MONSTER, A_QUESTION, A_COIN)}
    elsewhere = {key(CONTEXT, kind, COIN): 9.0 for kind in context}
    values = {context[best]: 1.0, key(FLO_LEVEL, A_COIN, 0, 1, 1, 0): 0.5} | elsewhere
    teach(agent, values)
    agent.agent_start(screen)
    agent.agent_end(0.0)
    assert learned(agent)[context[best]] < 1.0


def test_among_coins_the_values_choose() -> None:
    agent = begun(HierarchicalProgrammedAgent(epsilon=0.0))
    left, right = key(FLO_LEVEL, A_COIN, 0, -1, 1, 0), key(FLO_LEVEL, A_COIN, 0, 1, 1, 0)
    teach(agent, {left: -1.0, right: -0.5})
    agent.agent_start(draw("$ $", " M", GROUND))
    agent.agent_end(0.0)
    assert learned(agent)[left] == -1.0
    assert learned(agent)[right] == pytest.approx(-0.5 + 0.3 * 0.5)


def test_marios_kind_and_if_wanted_the_tile_above_are_in_the_keys_of_klos() -> None:
    screen = draw("b", "", "$", "M", GROUND, mario=10)
    for tile_above, more in ((False, ()), (True, (ord("b"),))):
        agent = begun(HierarchicalProgrammedAgent(tile_above=tile_above))
        action = number(agent.agent_start(screen))
        agent.agent_end(1.0)
        assert set(learned(agent)) == {
            key(FLO_LEVEL, A_COIN, 0, 0, 1, 0),
            key(KLO_LEVEL, A_COIN, 0, 0, 1, 0, 10, *more, action),
        }


def test_facts_make_far_coins_reachable() -> None:
    screen = draw("   $   ", "", "", "  11111   ", "", "M", GROUND)
    for kind, opens in ((HierarchicalAgent, False), (HierarchicalFactsAgent, True)):
        agent = begun(kind())
        agent.agent_start(screen)
        agent.agent_end(-1.0)
        assert (agent.agent_message("values") != "0") is opens


# Internal rewards


def internal() -> HierarchicalAgent:
    return begun(HierarchicalInternalAgent(epsilon=0.0))


def klo_values(agent: HierarchicalAgent, flo_keys: set[int]) -> list[float]:
    return sorted(value for key, value in learned(agent).items() if key not in flo_keys)


def test_klos_are_paid_for_the_goal_and_flos_by_the_environment() -> None:
    agent = internal()
    flo_keys = {key(FLO_LEVEL, A_COIN, 0, 1, 1, 0), key(CONTEXT, A_COIN, COIN)}
    agent.agent_start(draw(" $", "M", GROUND))
    agent.agent_step(5.0, draw(" $", " M", GROUND))
    assert klo_values(agent, flo_keys) == pytest.approx([0.3 * -0.01])
    agent.agent_step(7.0, draw(" M", GROUND))
    assert klo_values(agent, flo_keys) == pytest.approx([0.3 * -0.01, 0.3 * 0.99])
    agent.agent_end(100.0)
    assert [learned(agent)[flo] for flo in flo_keys] == pytest.approx([0.15 * (12.0 + 0.9 * 100.0)] * 2)
    assert klo_values(agent, flo_keys) == pytest.approx([0.3 * -0.01, 0.3 * 0.99])


@pytest.mark.parametrize(
    ("then", "camera", "reached"),
    [
        ((" M", "", GROUND), 0, True),  # Mario is where it was
        (("M  $", GROUND), 0, False),  # still there, out of reach once Mario has moved
        (("  M", GROUND), 0, True),
        (("M", GROUND), 5, False),  # out of view
    ],
)
def test_a_coins_goal_is_that_its_tile_is_empty(then: tuple[str, ...], camera: int, reached: bool) -> None:
    agent = internal()
    agent.agent_start(draw("  M$", GROUND))
    agent.agent_step(0.0, draw(*then, camera=camera))
    assert max(learned(agent).values()) == pytest.approx(0.3 * 0.99 if reached else 0.3 * -0.01)


@pytest.mark.parametrize(
    ("place", "reached"),
    [
        (None, True),
        ((4.5, 1.0), True),  # 3.5 tiles behind
        ((5.0, 7.0), False),  # 3 tiles behind, and too high to be a threat
        ((12.0, 1.0), False),
    ],
)
def test_a_monsters_goal_is_that_it_is_gone_or_left_behind(
    place: tuple[float, float] | None, reached: bool
) -> None:
    agent = internal()
    agent.agent_start(draw(GROUND, at=(8.0, 1.0), monsters=[(GOOMBA, 6.0, 1.0, 0.0, 0.0)]))
    monsters = [] if place is None else [(GOOMBA, *place, 0.0, 0.0)]
    agent.agent_step(0.0, draw(GROUND, at=(8.0, 1.0), monsters=monsters))
    assert klo_values(agent, set()) == pytest.approx([0.3 * 0.99 if reached else 0.3 * -0.01])


@pytest.mark.parametrize(("reward", "paid"), [(-10.0, -10.0), (-3.0, -10.0), (100.0, 0.0)])
def test_death_is_paid_and_the_finish_line_is_not(reward: float, paid: float) -> None:
    agent = internal()
    action = number(agent.agent_start(draw(" $", "M", GROUND)))
    agent.agent_end(reward)
    assert learned(agent)[key(KLO_LEVEL, A_COIN, 0, 1, 1, 0, 0, action)] == pytest.approx(0.3 * paid)
    assert learned(agent)[key(CONTEXT, A_COIN, COIN)] == pytest.approx(0.15 * reward)


# Sums over objects


def test_a_klos_value_is_shared_by_all_objects_of_its_flos_kind() -> None:
    """Two coins and a monster too far to be a threat: the coins share the coin's update."""
    agent = begun(ObjectsCoarseAgent(epsilon=0.0))
    screen = draw("$ $", " M", GROUND, monsters=[(GOOMBA, 15.0, 1.0, 0.0, 0.0)])
    first = number(agent.agent_start(screen))
    agent.agent_step(-0.01, screen)
    coins = [key(KLO_LEVEL, A_COIN, 0, dx, 1, 0, 0, first) for dx in (-1, 1)]
    assert learned(agent) == pytest.approx(dict.fromkeys(coins, 0.15 * -0.01))


def test_all_visible_monsters_share_a_tackle() -> None:
    agent = begun(ObjectsCoarseAgent(epsilon=0.0))
    monsters = [(GOOMBA, 3.0, 1.0, -0.5, 0.0), (GOOMBA, 15.0, 1.0, 0.0, 0.0)]
    screen = draw(GROUND, at=(1.0, 1.0), monsters=monsters)
    first = number(agent.agent_start(screen))
    agent.agent_step(-0.01, screen)
    near = key(KLO_LEVEL, A_MONSTER, GOOMBA, 4, 0, 1, 0, first)  # speeds: left, none
    far = key(KLO_LEVEL, A_MONSTER, GOOMBA, 28, 0, 4, 0, first)  # none, none
    assert learned(agent) == pytest.approx({near: 0.15 * -0.01, far: 0.15 * -0.01})


def test_a_screen_full_of_monsters_is_no_trouble() -> None:
    """The maximum number of features, for long enough that the table must grow."""
    agent = begun(ObjectsCoarseAgent(epsilon=0.0))
    for i in range(12):
        crowd = [(GOOMBA, 2.0 + 0.01 * n, 1.0 + 0.5 * i, 0.0, 0.0) for n in range(511)]
        screen = draw(GROUND, at=(1.0, 1.0), monsters=crowd, mario=i)
        agent.agent_start(screen)
        agent.agent_step(-1.0, screen)
        agent.agent_end(-1.0)
    assert len(learned(agent)) == int(agent.agent_message("values"))
