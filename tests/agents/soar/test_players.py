"""Soar agents as players: learning, seeds, saves, and everything that may go wrong with productions."""

from __future__ import annotations

import re
from collections.abc import Callable
from functools import partial
from pathlib import Path

import pytest

from agents.soar.agents import SoarAgent, SoarHierarchicalAgent, SoarMinesAgent, SoarPlayer, parse_rules
from agents.soar.kernel import SoarError
from env_server.toys import MinesEnvironment, SkeletonEnvironment
from glue import Action, ConfigError, GlueError, Observation, SaveError, check_agent, local
from glue.plugins.loading import find, names
from glue.saves import Saved, pack, unpack
from glue.wire.messages import Role
from tests.contract.test_installed_players import observe
from tests.players import returns

pytest.importorskip("soar_sml", reason="agents on the Soar kernel need it: pip install 'glue-rl[soar]'")

NAMES = [name for name in names(Role.AGENT) if name.startswith("soar-")]

UP = Path(__file__).with_name("up.soar").read_text("utf-8")

SKELETON = SkeletonEnvironment().env_init()

Write = Callable[[str], SoarAgent]


@pytest.fixture
def productions(tmp_path: Path) -> Write:
    """Return a function that makes an agent of the given productions."""

    def written(text: str, max_cycles: int = 30) -> SoarAgent:
        file = tmp_path / "my.soar"
        file.write_text(text)
        return SoarAgent(productions=str(file), max_cycles=max_cycles)

    return written


def begun(agent: SoarPlayer, task_spec: str = SKELETON) -> SoarPlayer:
    agent.agent_init(task_spec)
    return agent


def test_ones_own_productions_play_any_task(productions: Write) -> None:
    with local(productions(UP), SkeletonEnvironment()) as experiment:
        experiment.rl_init()
        assert experiment.rl_episode(0)
        assert (experiment.rl_return(), experiment.rl_num_steps()) == (1.0, 10)


def test_the_example_learns_the_way_across_the_mines() -> None:
    with local(SoarMinesAgent(), MinesEnvironment()) as glue:
        glue.rl_init(seed=1)
        learned = returns(glue, 400, 500)
    assert sum(learned[-50:]) / 50 > sum(learned[:50]) / 50 + 20


def test_all_are_installed() -> None:
    assert len(NAMES) == 7


@pytest.mark.parametrize("name", NAMES)
def test_agent_keeps_the_contract(name: str) -> None:
    task = "mines" if name == "soar-mines" else "mario"
    task_spec = find(Role.ENVIRONMENT, task)().env_init()
    check_agent(find(Role.AGENT, name), task_spec, observation=partial(observe, task), episodes=2, steps=20)


# Faults


def test_a_production_that_does_not_parse_is_named(productions: Write) -> None:
    with pytest.raises(ConfigError, match=r"my\.soar.*do not load(.|\n)*broken"):
        begun(productions("sp {broken\n (state <s> ^superstate nil\n-->\n (<s> ^a b)\n}\n"))


def test_a_file_that_is_not_there_and_none_at_all_are_named(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"no file of productions .*none\.soar"):
        begun(SoarAgent(productions=str(tmp_path / "none.soar")))
    with pytest.raises(ConfigError) as caught:
        begun(SoarAgent())
    assert caught.value.settings == ("productions",)


IDLE = "sp {idle\n (state <s> ^superstate nil)\n-->\n (<s> ^a b)\n}\n"
HALTS = "sp {stop\n (state <s> ^superstate nil ^io.input-link.observation.int-1 10)\n-->\n (halt)\n}\n"
LEARNS = "sp {learn\n (state <s> ^superstate nil ^io.input-link.step)\n-->\n (exec once |sp {wrong|)\n}\n"


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        (IDLE, r"no command .* in 30 decision cycles(.|\n)*state no-change"),
        (HALTS, "halted in the middle of an episode"),
        (UP + LEARNS, "wrong"),  # a command in `once` that Soar refuses
        # Actions that the task does not have.
        (UP.replace("^int-1 1", "^int-1 7"), "int 0 is 7"),
        (UP.replace("^int-1 1", "^int-2 1"), r"has \^int-1; .*\^int-2 1"),
        (UP.replace("^int-1 1", "^int-1 up"), "up"),
    ],
)
def test_productions_that_do_not_act_as_they_must_are_stopped(
    productions: Write, text: str, complaint: str
) -> None:
    agent = begun(productions(text))
    with pytest.raises(SoarError, match=complaint):
        agent.agent_start(Observation([10]))


def test_marios_agents_refuse_other_tasks() -> None:
    with pytest.raises(ConfigError, match="Infinite Mario only"):
        SoarHierarchicalAgent().agent_init(SKELETON)


# Saves may come from anyone.

RULE = """\
sp {rl*1
    (state <s> ^operator <o> +)
    (<o> ^name up)
    -->
    (<s> ^operator <o> = 0.500000)
}
"""


def test_rules_are_read_one_by_one() -> None:
    assert parse_rules(RULE + "\n" + RULE) == [RULE.strip()] * 2
    assert parse_rules(RULE.replace("^name up", "^x { >= 1 < 2 } ^y |a b|")) != []


@pytest.mark.parametrize(
    "text",
    [
        "cd /",
        RULE + "cd /",
        RULE.replace("(<s> ^operator <o> = 0.500000)", "(cmd cd /)"),
        RULE.replace("= 0.500000)", "= 0.500000)\n    (cmd cd /)"),
        RULE.replace("^name up)", "^name up)}\n    cd /\n    sp {x (state <s>)"),
        RULE.replace("^name up)", "^name |}|)"),
        RULE.replace("^name up)", "^name up) --> (cmd cd /)} sp {x (state <s>)"),
        RULE.replace("rl*1", "rl*1} cd / {"),
    ],
)
def test_whatever_is_not_a_rule_with_a_value_is_refused(text: str) -> None:
    with pytest.raises(SaveError, match="rule"):
        parse_rules(text)


def test_a_save_of_another_agent_or_with_other_commands_is_refused() -> None:
    mines = MinesEnvironment()
    agent = begun(SoarMinesAgent(), mines.env_init())
    good = unpack(agent.agent_save(), "soar-mines", {})
    hostile = Saved(
        good.player, good.settings, good.numbers, {**good.arrays, "rules": good.arrays["rules"][5:]}
    )
    for data in (b"", pack(hostile), pack(Saved("random", {}, {}, {}))):
        with pytest.raises(GlueError):
            agent.agent_load(data)
    assert isinstance(agent.agent_start(mines.env_start()), Action)


def test_five_thousand_episodes_leave_nothing_behind() -> None:
    agent = SoarMinesAgent()
    with local(agent, MinesEnvironment()) as glue:
        glue.rl_init(seed=1)
        returns(glue, 1000, 500)
        learned = in_use(agent)
        returns(glue, 4000, 500)
        assert in_use(agent) == learned


def in_use(agent: SoarPlayer) -> tuple[str, ...]:
    """Return Soar's counts of rules, of working memory elements, and of allocated bytes."""
    assert agent._kernel is not None
    printed = agent._kernel.command("stats") + agent._kernel.command("stats --memory")
    patterns = (r"(\d+) productions", r"WM size: (\d+) current", r"(\d+) bytes total")
    return tuple(re.search(pattern, printed)[1] for pattern in patterns)  # type: ignore[index]
