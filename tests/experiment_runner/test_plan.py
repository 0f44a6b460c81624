from __future__ import annotations

import textwrap
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import pytest
from hypothesis import given
from hypothesis import strategies as st

import experiment_runner.plan_file as plan_file
from experiment_runner.plan import (
    Plan,
    RoleSpec,
    RoleSweep,
    check_options,
    describe,
    differences,
    trial_seed,
)
from experiment_runner.plan_file import dump_plan, load_plan, parse_plan
from glue.errors import ConfigError, ExperimentError
from glue.options import Option

SMALL = """
episodes = 20
trials = 2
seed = 7

[environments.mario]
level_seed = [121, 122]

[agents.random]

[agents.textbook]
class = "tiles"
terminal_update = true
"""


class Learner:
    def __init__(
        self,
        *,
        step_size: Annotated[float, Option("how far to move", low=0, high=1)] = 0.3,
        terminal_update: bool = False,
    ) -> None: ...


def find(role: str, name: str) -> type:
    if (role, name) == ("agent", "learner"):
        return Learner
    raise ConfigError(f"no {role} is called {name}")


def test_plan_of_the_manual_expands_to_every_combination() -> None:
    manual = textwrap.dedent((plan_file.__doc__ or "").split("files:\n")[1].split("\nThe heading")[0])
    specs = parse_plan(manual).expand()
    assert len(specs) == (1 + 2 + 1) * 2 * 10
    assert "hierarchical/step_size=0.1/mario/level_difficulty=0/3" in [spec.id for spec in specs]
    textbook = next(spec for spec in specs if spec.id.startswith("textbook/"))
    assert textbook.agent == RoleSpec("tiles", {"terminal_update": True}, "textbook")
    assert textbook.environment == RoleSpec("mario", {"level_seed": 121, "level_difficulty": 0}, "mario")
    assert (textbook.episodes, textbook.max_steps) == (5000, 0)


def test_trials_of_one_combination_stand_together() -> None:
    assert [spec.id for spec in parse_plan(SMALL).expand()] == [
        "random/mario/level_seed=121/0",
        "random/mario/level_seed=121/1",
        "random/mario/level_seed=122/0",
        "random/mario/level_seed=122/1",
        "textbook/mario/level_seed=121/0",
        "textbook/mario/level_seed=121/1",
        "textbook/mario/level_seed=122/0",
        "textbook/mario/level_seed=122/1",
    ]


def test_role_left_out_connects_from_outside() -> None:
    (spec,) = Plan(episodes=1).expand()
    assert (spec.id, spec.agent, spec.environment) == ("remote/remote/0", None, None)


def test_seeds_never_change() -> None:
    # Results published with a seed must come out again: these numbers are for ever.
    assert trial_seed(0, "random/mario/0") == 7593334813259204855
    assert trial_seed(1, "random/mario/0") == 5791283649594944414
    assert trial_seed(1, "random/mario/1") == 1853160605154404608


def test_trial_keeps_its_seed_when_the_plan_grows() -> None:
    small = parse_plan(SMALL)
    grown = replace(
        small,
        trials=3,
        environments=(replace(small.environments[0], options={"level_seed": (5, 122, 121)}),),
        agents=(RoleSweep("sample"), *reversed(small.agents)),
    )
    seeds = {spec.id: spec.seed for spec in grown.expand()}
    assert all(seeds[spec.id] == spec.seed for spec in small.expand())
    assert len(set(seeds.values())) == len(seeds)
    assert all(0 <= seed < 2**63 for seed in seeds.values())


def test_class_by_path_is_labelled_by_its_class() -> None:
    plan = parse_plan('episodes = 1\n[agents."mine/my_agent.py:MyAgent"]\nspeed = 3')
    assert plan.expand()[0].agent == RoleSpec("mine/my_agent.py:MyAgent", {"speed": 3}, "MyAgent")


names = st.text("abcdefgh_+-.0123456789", min_size=1, max_size=8)
values = st.one_of(
    st.booleans(),
    st.integers(-(2**63), 2**63 - 1),
    st.floats(allow_nan=False),
    st.text(st.characters(exclude_categories=["Cs"]), max_size=8),
)
sweeps = st.builds(
    RoleSweep,
    name=names.map(lambda name: f"package.module:{name}"),
    options=st.dictionaries(
        st.text("abcdefgh_ \"'\n\x7fé", max_size=5),
        st.one_of(values, st.lists(values, min_size=1, max_size=3).map(tuple)),
        max_size=3,
    ),
    label=names,
)
roles = st.lists(sweeps, max_size=3, unique_by=lambda sweep: sweep.label).map(tuple)


@given(st.builds(Plan, episodes=st.integers(1, 2**63 - 1), environments=roles, agents=roles))
def test_dumped_plan_reads_back_equal(plan: Plan) -> None:
    back = parse_plan(dump_plan(plan))
    assert back == plan
    assert dump_plan(back) == dump_plan(plan)  # true, 1 and 1.0 are equal, but not the same option


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("episodes = 1\ntrials: 2", "not TOML: .*line 2"),
        ("trials = 3", "number of episodes"),
        ("episodes = 5\nepisode = 5", "no 'episode'; did you mean episodes"),
        ("episodes = 5\nlevel = 5", "no 'level'; choose from episodes, max_steps, trials"),
        ("episodes = 0", "episodes must be a whole number from 1 to .*, not 0"),
        ('episodes = "many"', "episodes must be a whole number .*'many'"),
        ("episodes = true", "episodes must be a whole number .*True"),
        ("episodes = 5\nmax_steps = 4294967296", "max_steps must be .* from 0 to 4294967295"),
        ("episodes = 5\nseed = -1", "seed must be .* from 0"),
        ('episodes = 5\nagents = "random"', r"agents are written as tables, as in: \[agents.NAME\]"),
        ('episodes = 5\n[agents]\nname = "random"', r"agents.name is written as a table"),
        ("episodes = 5\n[agents.a]\nclass = 3", "class of agents.a names one class, not 3"),
        ("episodes = 5\n[agents.a]\nspeed = []", "option speed of a has an empty list"),
        ("episodes = 5\n[agents.a]\nspeed = [[1]]", "option speed of a takes a number"),
        ("episodes = 5\n[agents.a]\nspeed = 2020-01-01", "option speed of a takes a number"),
        ('episodes = 5\n[agents."a b"]', "'a b' cannot label"),
        ('episodes = 5\n[agents."x:A"]\n[agents."y:A"]', "two agents are called A"),
    ],
)
def test_faulty_plan_is_refused_with_the_fault(text: str, message: str) -> None:
    with pytest.raises(ExperimentError, match=message):
        parse_plan(text)


def test_value_listed_twice_is_refused() -> None:
    with pytest.raises(ExperimentError, match="random/x=1/remote/0 twice"):
        parse_plan("episodes = 1\n[agents.random]\nx = [1, 1]").expand()


def test_load_names_the_file(tmp_path: Path) -> None:
    path = tmp_path / "plan.toml"
    with pytest.raises(ExperimentError, match=r"plan.toml: No such file"):
        load_plan(path)
    path.write_bytes(b"\xff")
    with pytest.raises(ExperimentError, match=r"plan.toml: it is not UTF-8"):
        load_plan(path)
    path.write_text("episode = 3")
    with pytest.raises(ExperimentError, match=r"plan.toml: a plan has no 'episode'"):
        load_plan(path)
    path.write_text(SMALL)
    assert load_plan(path) == parse_plan(SMALL)


def test_options_are_checked_and_widened() -> None:
    plan = Plan(episodes=1, agents=(RoleSweep("learner", {"step_size": (0, 0.5)}),))
    checked = check_options(plan, find)
    assert [spec.id for spec in checked.expand()] == [
        "learner/step_size=0.0/remote/0",
        "learner/step_size=0.5/remote/0",
    ]


@pytest.mark.parametrize(
    ("sweep", "message"),
    [
        (RoleSweep("lerner"), "no agent is called lerner"),
        (RoleSweep("learner", {"stepsize": 0.1}), "learner has no option stepsize; did you mean step_size"),
        (RoleSweep("learner", {"step_size": (0.1, 2)}), "step_size must be from 0 to 1, not 2"),
        (RoleSweep("learner", {"terminal_update": 1}), "terminal_update takes true or false, not 1"),
    ],
)
def test_wrong_option_is_refused(sweep: RoleSweep, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        check_options(Plan(episodes=1, agents=(sweep,)), find)


def test_differences_say_what_differs() -> None:
    ours = parse_plan(SMALL)
    theirs = Plan(
        episodes=30,
        trials=2,
        seed=7,
        environments=(RoleSweep("mario", {"level_seed": (121, 123)}),),
        agents=(RoleSweep("flat", {"terminal_update": True, "x": 1}, "textbook"), RoleSweep("sample")),
    )
    assert differences(ours, ours) == []
    assert differences(ours, theirs) == [
        "episodes is 30, not 20",
        "level_seed of mario is 121,123, not 121,122",
        "agents lack random",
        "agents include sample",
        "textbook is flat, not tiles",
        "x of textbook is 1, not the default",
    ]


def test_description_lists_every_trial_with_its_seed() -> None:
    plan = parse_plan(SMALL)
    lines = describe(plan).splitlines()
    assert lines[:3] == [
        "8 trials of 20 episodes without a step limit; seed 7",
        "agents        random; textbook (tiles) terminal_update=true",
        "environments  mario level_seed=121,122",
    ]
    assert [line.split()[0] for line in lines[4:]] == [spec.id for spec in plan.expand()]
    assert lines[4].endswith(f"seed {plan.expand()[0].seed}")
    remote = describe(Plan(episodes=1, max_steps=9))
    assert "cut off after 9 steps" in remote
    assert "agents        connects from outside" in remote
