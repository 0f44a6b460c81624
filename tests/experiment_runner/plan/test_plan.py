from __future__ import annotations

import textwrap
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

import experiment_runner.plan.file as plan_file
from experiment_runner.cli.make_plan import make_plan
from experiment_runner.plan.file import dump_plan, load_plan, parse_plan
from experiment_runner.plan.limits import PLAYERS
from experiment_runner.plan.metrics import Keep, MetricsPlan
from experiment_runner.plan.plan import Plan, RoleSpec, RoleSweep, describe, differences
from experiment_runner.plan.user_files import named_code
from glue.errors import ConfigError, ExperimentError

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


def test_plan_of_the_manual_expands_to_every_combination() -> None:
    manual = textwrap.dedent((plan_file.__doc__ or "").split("files:\n")[1].split("\nThe heading")[0])
    specs = parse_plan(manual).expand()
    assert len(specs) == (1 + 2 + 1) * 2 * 10
    assert "hierarchical/step_size=0.1/mario/level_difficulty=0/3" in [spec.id for spec in specs]
    textbook = next(spec for spec in specs if spec.id.startswith("textbook/"))
    assert textbook.agent == RoleSpec("tiles", {"terminal_update": True}, "textbook")
    assert textbook.environment == RoleSpec("mario", {"level_seed": 121, "level_difficulty": 0}, "mario")
    assert (textbook.episodes, textbook.max_steps) == (5000, 0)


def test_a_plan_of_too_many_trials_is_refused_before_they_are_made(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("experiment_runner.plan.plan._MOST_TRIALS", 8)
    plan = parse_plan(SMALL)
    assert len(plan.expand()) == 8
    for wrong in (replace(plan, trials=3), replace(plan, agents=(RoleSweep("x", {"a": (1, 2, 3)}),))):
        with pytest.raises(ExperimentError, match="more than 8 trials"):
            wrong.expand()


def test_trials_of_one_combination_stand_together() -> None:
    assert [spec.id for spec in parse_plan(SMALL).expand()] == [
        f"{agent}/mario/level_seed={seed}/{number}"
        for agent, seed, number in product(("random", "textbook"), (121, 122), (0, 1))
    ]


def test_role_left_out_connects_from_outside() -> None:
    (spec,) = Plan(episodes=1).expand()
    assert (spec.id, spec.agent, spec.environment) == ("remote/remote/0", None, None)


def test_seeds_never_change() -> None:
    # Results published with a seed must be reproducible: these numbers never change.
    old = Plan(1, 0, 2, 1, (RoleSweep("mario"),), (RoleSweep("random"),))
    assert [spec.seed for spec in replace(old, seeds="id").expand()] == [
        5791283649594944414,
        1853160605154404608,
    ]
    assert [spec.seed for spec in old.expand()] == [23895184530532179, 7247361678685053421]


def test_seed_depends_on_the_number_of_the_trial_only() -> None:
    specs = replace(parse_plan(SMALL), trials=3).expand()
    seeds = {spec.id.number: spec.seed for spec in specs}
    assert [spec.seed for spec in specs] == [seeds[spec.id.number] for spec in specs]
    assert len(set(seeds.values())) == 3
    remote = replace(parse_plan(SMALL), agents=(), environments=())
    assert [spec.seed for spec in remote.expand()] == [seeds[0], seeds[1]]


def test_plan_of_an_older_run_keeps_the_derivation_of_its_seeds() -> None:
    old = parse_plan(SMALL, "id")
    assert old.seeds == "id"
    assert parse_plan(dump_plan(old)) == old
    assert len({spec.seed for spec in old.expand()}) == 8


@pytest.mark.parametrize(
    ("name", "label"),
    [
        ("mine/my_agent.py:MyAgent", "MyAgent"),
        ("gymnasium:env_server.gym:glue/InfiniteMario-v0", "glue-InfiniteMario-v0"),
        ("openenv:http://127.0.0.1:8000", "127.0.0.1-8000"),
        ("ALE/Pong-v5", "ALE-Pong-v5"),
        ("a b (c)", "a-b-c"),
        ("größe", "größe"),
        ("/", "-"),
    ],
)
def test_any_name_makes_a_label(name: str, label: str) -> None:
    (spec,) = Plan(episodes=1, agents=(RoleSweep(name),)).expand()
    assert spec.agent == RoleSpec(name, {}, label)
    assert spec.id == f"{label}/remote/0"


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


inside = st.lists(st.sampled_from([*PLAYERS]), unique=True).map(tuple)


paces = st.fixed_dictionaries(
    {
        "rate": st.floats(0.001, 1000),
        "late": st.sampled_from(["repeat", "0,-1", "0.5"]),
        "delay": st.integers(0, 1000),
    }
)


readings = st.fixed_dictionaries(
    {
        "metrics": st.builds(
            MetricsPlan,
            st.integers(0, 99),
            st.dictionaries(names, st.builds(Keep, st.integers(1, 99), st.booleans()), max_size=2),
        ),
        "extras": st.dictionaries(
            st.sampled_from(["coins", "left.speed"]), st.sampled_from(["last", "mean", "max"])
        ),
    }
)


@given(st.integers(1, 2**63 - 1), roles, roles, inside, st.one_of(st.just({}), paces), st.just({}) | readings)
def test_dumped_plan_reads_back_equal(
    episodes: int,
    environments: tuple[RoleSweep, ...],
    agents: tuple[RoleSweep, ...],
    inside: Any,
    pace: dict[str, Any],
    read: dict[str, Any],
) -> None:
    plan = Plan(episodes=episodes, environments=environments, agents=agents, inside=inside, **pace, **read)
    back = parse_plan(dump_plan(plan))
    assert back == plan
    assert dump_plan(back) == dump_plan(plan)  # true, 1 and 1.0 are equal, but different options


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("episodes = 1\ntrials: 2", "not TOML: .*line 2"),
        ("episodes = 1\nx = " + "[" * 100_000, "nested too deeply"),
        (f"episodes = 1\n[agents{'.a' * 16}]", "option a of a takes a number"),
        (f"episodes = 1\n[agents{'.a' * 50_000}]", "nested too deeply"),
        (f"""x = ["\""\\"\""\"", {{a{".a" * 50_000} = 1}}] # ".\"""", "nested too deeply"),
        (f"episodes = {'9' * 5_000}", "not TOML"),
        ("trials = 3", "number of episodes"),
        ("episodes = 5\nepisode = 5", "line 2: .*no 'episode'; did you mean episodes"),
        ("episodes = 5\nlevel = 5", "no 'level'; choose from episodes, max_steps, trials, seed"),
        ("episodes = 5\nmetric_every = 5", "did you mean metrics_every"),
        ("episodes = 0", "a plan needs one of them"),
        ("episodes = 5\nsteps = 5", "line 2: .*a plan needs only one of them"),
        ('episodes = "many"', "episodes must be a whole number, not 'many'"),
        ("episodes = true", "episodes must be a whole number, not True"),
        ("episodes = 5\nmax_steps = 4294967296", "max_steps must be .* <= 4294967295, not 4294967296"),
        ("episodes = 5\nseed = -1", "line 2: seed must be .* >= 0"),
        ('episodes = 5\nagents = "random"', r"agents must be tables, as in: \[agents.NAME\]"),
        ('episodes = 5\n[agents]\nname = "random"', r"agents.name must be a table"),
        ("episodes = 5\n[agents.a]\nclass = 3", "line 3: class of agents.a names one class, not 3"),
        ("episodes = 5\n[agents.a]\nslow = 1\nspeed = []", "line 4: option speed of a has an empty list"),
        ("episodes = 5\n[agents.a]\nspeed = [[1]]", "option speed of a takes a number"),
        ("episodes = 5\n[agents.a]\nspeed = 2020-01-01", "option speed of a takes a number"),
        ("episodes = 5\n[agents.a]\nspeed = 0x" + 5000 * "f", "option speed of a takes a number"),
        ("episodes = 5\nrate = 2000", "a rate is from 0.001 to 1000 steps per second"),
        ('episodes = 5\nlate = "1"', "give a rate or a delay, too"),
        ('episodes = 5\nrate = 2\nlate = "now"', "late is `repeat`, or the numbers of an action"),
        ("episodes = 5\ndelay = -1", "a delay is from 0 to 1000 steps, not -1"),
        ('episodes = 5\nseeds = "name"', "line 2: seeds cannot be 'name'; did you mean number"),
        ("episodes = 5\nseeds = 0x" + 5000 * "f", "seeds cannot be .*; choose from number, id"),
        ('episodes = 5\ninside = "env"', r"inside must be a list, as in \[.*\], not 'env'"),
        ("episodes = 5\ninside = [1]", "line 2: inside cannot be 1; choose from agent, env"),
        ('episodes = 5\ninside = ["mines"]', "inside cannot be 'mines'; choose from agent, env"),
        ('episodes = 5\n[agents."x:A"]\n[agents."y:A"]', "two agents are called A"),
        ("episodes = 5\nmetrics_every = -1", "line 2: metrics_every must be"),
        ("episodes = 5\n[metrics]\n'mean TD error' = 'last'", "line 3: "),
        ("episodes = 5\n[tune]\ntrials = 0\n[tune.agents.sarsa]\nstep_size = [0.1]", "line 3: "),
        ("episodes = 5\n[tune.agents.sarsa]\nstep_size = {low = 2, high = 1}", "line 3: "),
        ("episodes = 5\n[tune.agents.sarsa]\nstep_size = {low = 1, hihg = 2}", "line 3: "),
        ("episodes = 5\n[agents.sarsa]\n[tune.agents.srasa]\nstep_size = [0.1]", "line 3: "),
    ],
)
def test_faulty_plan_is_refused_with_the_fault_and_its_line(text: str, message: str, tmp_path: Path) -> None:
    path = tmp_path / "plan.toml"
    path.write_text(text)
    with pytest.raises(ExperimentError, match=f"^{path}.*{message}"):
        load_plan(path)


def test_load_names_the_file(tmp_path: Path) -> None:
    path = tmp_path / "plan.toml"
    with pytest.raises(ExperimentError, match=r"plan.toml: No such file"):
        load_plan(path)
    path.write_bytes(b"\xff")
    with pytest.raises(ExperimentError, match=r"plan.toml: it is not UTF-8"):
        load_plan(path)
    path.write_bytes(b"#" * (2**22 + 1))
    with pytest.raises(ExperimentError, match=r"plan.toml: it has more than 4,194,304 bytes"):
        load_plan(path)
    path.write_text("episode = 3")
    with pytest.raises(ExperimentError, match=r"plan.toml, line 1: a plan has no 'episode'"):
        load_plan(path)
    path.write_text(SMALL)
    assert load_plan(path) == parse_plan(SMALL)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ("trials =", r": this is not TOML: Invalid value \(at line 2, column 9\)"),
        ("steps = 3", ".*: a plan needs only one of them"),
        (
            "[agents.mine]\nclass = 'sarsa'\nstepsize = 1",
            ", line 4: mine .* stepsize; did you mean step_size",
        ),
        ("[agents.srasa]", ", line 2: no agent .*'srasa'; did"),
        ("[agents.mine]\nclass = 'srasa'", ", line 3: no agent .*'srasa'; did"),
        ("[agents.sarsa]\nstep_size = [0.1, 7]", ".*sarsa: option step_size must be from 0 to 1"),
        ("[agents.sarsa]\nstep_size = [0.5, 0.5]", ": the plan has trial sarsa/step_size=0.5/remote/0 twice"),
    ],
)
def test_mistake_in_a_plan_is_one_of_the_command(tmp_path: Path, wrong: str, message: str) -> None:
    path = tmp_path / "plan.toml"
    path.write_text(f"episodes = 3\n{wrong}\n")
    with pytest.raises(ConfigError, match=f"^{path}{message}"):  # a ConfigError makes the exit code 2
        make_plan(path, {}, {})


def test_options_of_a_plan_are_widened(tmp_path: Path) -> None:
    path = tmp_path / "plan.toml"
    path.write_text("episodes = 3\n[agents.sarsa]\nstep_size = [0, 0.5]\n")
    assert [spec.id for spec in make_plan(path, {}, {}).expand()] == [
        "sarsa/step_size=0.0/remote/0",
        "sarsa/step_size=0.5/remote/0",
    ]


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
    assert differences(ours, replace(ours, rate=24.0)) == ["rate is 24.0, not 0.0"]
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
    timed = describe(Plan(episodes=1, rate=24.0, late="0", delay=2)).splitlines()[0]
    assert "24 steps per second, actions delayed by 2 steps, in place of late ones 0; seed" in timed
    remote = describe(Plan(episodes=1, max_steps=9))
    assert "cut off after 9 steps" in remote
    assert "agents        connects from outside" in remote


@pytest.mark.parametrize(
    ("name", "options", "code"),
    [
        ("mario", {"level_seed": 3, "world": "7"}, []),
        ("gymnasium:glue/InfiniteMario-v0", {}, []),
        ("gymnasium:theirs:glue/InfiniteMario-v0", {}, ["gymnasium:theirs:glue/InfiniteMario-v0"]),
        ("pettingzoo:theirs.game", {}, ["pettingzoo:theirs.game"]),
        ("theirs:Class", {}, ["theirs:Class"]),
        ("theirs.py:Class", {}, ["theirs.py"]),
        ("mario", {"level": "FILE", "level_digest": "0"}, []),
        ("soar", {"productions": "FILE"}, ["FILE"]),
        ("sb3", {"policy": ("none.zip", "FILE")}, ["FILE"]),
        ("pettingzoo:go_v5", {"opponent": "sarsa"}, []),
        ("pettingzoo:go_v5", {"opponent": ("theirs.py:Go", "theirs:Go")}, ["theirs.py", "theirs:Go"]),
        ("chat", {"model": "m", "url": "https://theirs.example/v1"}, ["https://theirs.example/v1"]),
    ],
)
def test_what_a_run_names_may_do_harm_unless_it_is_installed_or_has_a_digest(
    name: str,
    options: dict[str, Any],
    code: list[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("FILE").touch()
    player = RoleSweep(name, options, "x")
    assert named_code([player, None, player]) == [
        str(tmp_path / one) if one == "FILE" else one for one in code
    ]
