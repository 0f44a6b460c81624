"""Soar's values and ours: the same states have the same keys, and rank correlations."""

from __future__ import annotations

from itertools import product
from pathlib import Path

import numpy as np
import pytest

from agents.mohan2010.hierarchical import HierarchicalAgent
from env_server.mario.environment import InfiniteMario
from experiment_runner.executors.opening import open_run
from experiment_runner.store.records import Checkpoint, EpisodeResult
from experiment_runner.study.paper.experiments import EXPERIMENTS, plan_of
from glue import SaveError, local
from glue.saves import Saved, pack, unpack
from studies.shared_values import agreements, key_of, spearman
from studies.soar_values import CONTEXT, KEYSTROKE, OPERATOR, Learned, learned_values

RULE = """\
sp {{rl*{name}
    (state <s> ^operator <o> +)
    (<o> {tests})
    -->
    (<s> ^operator <o> = {value:f})
}}"""


def keystroke(seen: str, chosen: str, value: float) -> str:
    return RULE.format(
        name=f"{seen}*{chosen}", tests=f"^sees {seen} ^keystroke {chosen} ^name keystroke", value=value
    )


def operator(seen: str, value: float) -> str:
    return RULE.format(name=seen, tests=f"^sees {seen} ^learned yes", value=value)


def test_values_are_those_of_the_rules() -> None:
    context = RULE.format(
        name="c",
        tests="^context threat-yes-coin-no-question-no ^learned yes\n          ^name grab-coin",
        value=2,
    )
    assert learned_values([keystroke("coin*1*1*small", "jump", 0.5), operator("coin*1*1", -1), context]) == {
        Learned(KEYSTROKE, "coin*1*1*small", "jump"): 0.5,
        Learned(OPERATOR, "coin*1*1", ""): -1.0,
        Learned(CONTEXT, "threat-yes-coin-no-question-no", "grab-coin"): 2.0,
    }
    with pytest.raises(SaveError, match="not of an agent for Mario"):
        learned_values([RULE.format(name="up", tests="^name up", value=0)])


def test_our_agents_keep_the_same_states_under_these_keys() -> None:
    with local(HierarchicalAgent(seed=1), InfiniteMario(level_seed=121)) as glue:
        glue.rl_init()
        for _ in range(40):
            glue.rl_episode()
        saved = unpack(glue.rl_agent_save(), "hierarchical", {"grid": 2, "tile_above": False})
    keys = set(saved.arrays["keys"].tolist())
    moves = [*map("".join, product(("left", "right"), ("", "-jump"), ("", "-fast")))]
    moves += ["stay", "stay-fast", "jump", "jump-fast"]
    monsters = [
        f"{kind}*{dx}*{dy}*{motion}"
        for kind in ("goomba", "mushroom", "fire-flower", "shell")
        for dx, dy in product(range(-6, 8), range(-12, 10))
        for motion in ("stationary", "vertical", "towards", "away", "none")
    ]
    tiles = [f"{kind}*{dx}*{dy}" for kind in ("coin", "question") for dx in range(-2, 3) for dy in range(4)]
    bits = ["threat-{}-coin-{}-question-{}".format(*each) for each in product(("yes", "no"), repeat=3)]
    known = {key_of(Learned(OPERATOR, seen, "")) for seen in monsters + tiles}
    known |= {
        key_of(Learned(CONTEXT, seen, name))
        for seen in bits
        for name in ("tackle-monster", "search-question", "grab-coin")
    }
    known |= {
        key_of(Learned(KEYSTROKE, f"{seen}*{size}", move))
        for seen in monsters + tiles
        for size in ("small", "big", "fiery")
        for move in moves
    }
    assert len(keys) > 300
    assert keys <= known


@pytest.mark.parametrize("seen", ["dragon*1*1", "coin*1", "goomba*1*1*sideways", "coin*x*1"])
def test_what_our_agents_do_not_see_has_no_key(seen: str) -> None:
    with pytest.raises(SaveError, match="do not see"):
        key_of(Learned(OPERATOR, seen, ""))


def test_rank_correlation_shares_the_ranks_of_equal_numbers() -> None:
    assert spearman([1, 2, 3, 10], [2, 4, 8, 9]) == pytest.approx(1)
    assert spearman([1, 2, 3], [3, 2, 1]) == pytest.approx(-1)
    # ranks 1, 2.5, 2.5, 4 against 1, 2, 3, 4
    assert spearman([0, 5, 5, 7], [1, 2, 3, 4]) == pytest.approx(4.5 / np.sqrt(4.5 * 5))
    assert spearman([1, 1], [1, 2]) == 0


def test_trials_are_compared_in_pairs_over_the_values_that_both_have(tmp_path: Path) -> None:
    seen = [f"coin*1*{dy}*small" for dy in range(12)]

    def on_soar(values: list[float]) -> bytes:
        rules = [keystroke(what, "jump", value) for what, value in zip(seen, values, strict=True)]
        text = np.frombuffer("\n".join(rules).encode(), np.int8)
        return pack(Saved("soar-hierarchical", {}, {}, {"rules": text}))

    def ours(values: list[float]) -> bytes:
        found = sorted((key_of(Learned(KEYSTROKE, s, "jump")), v) for s, v in zip(seen, values, strict=True))
        keys, numbers = np.array([k for k, _ in found], np.uint64), np.array([v for _, v in found])
        return pack(
            Saved("hierarchical", {"grid": 2, "tile_above": False}, {}, {"keys": keys, "values": numbers})
        )

    rising = [float(i + 1) for i in range(12)]
    falling = rising[::-1]
    saves = [on_soar(rising), on_soar([*rising[:-1], 0.0]), ours(rising), ours(falling)]
    plan = plan_of(EXPERIMENTS["soar-5"], episodes=1, trials=2)
    with open_run(tmp_path / "soar-5", plan) as store:
        for spec, save in zip(plan.expand(), saves, strict=True):
            store.record(spec.id, EpisodeResult(1, 1.0, 1, True, 0.01), Checkpoint(save, b""))
    (found,) = agreements(tmp_path)
    assert (found.experiment, found.agent, found.kind) == ("soar-5", "soar-hierarchical", KEYSTROKE)
    assert found.shared == 11.5  # 12 of the first trial on Soar, 11 of the second
    assert found.soar_and_ours == pytest.approx(0)
    assert found.two_of_ours == pytest.approx(-1)
    assert found.two_on_soar == pytest.approx(1)
