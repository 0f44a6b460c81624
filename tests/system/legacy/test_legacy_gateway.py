"""Original programs join: every case of the original suites, in every language, mixture and order."""

from __future__ import annotations

import itertools
import struct

import pytest

from agents.tabular import SarsaAgent
from env_server.toys import MinesEnvironment
from glue import Action, Experiment, Observation, PeerFailed, Step, local
from tests.glue.engine.test_beside_players import ACTION, FULL, Seeing, Showing
from tests.players import ScriptedAgent, ScriptedEnvironment
from tests.system.conformance import SCENARIOS, FiveStepEnvironment, MirrorAgent, Seen
from tests.system.legacy.legacy_client import STYLES, Id
from tests.system.legacy.legacy_rig import Rig

BARE = FULL.without(mask=True, extras=True)
CHECKED = sorted(SCENARIOS.keys() - {"test_speed"})


@pytest.mark.parametrize("style", STYLES)
def test_the_cases_of_the_original_suites_pass_in_every_style(rig: Rig, style: str) -> None:
    for case in CHECKED:
        scenario = SCENARIOS[case]
        rig.originals(scenario.agent(), scenario.environment(), style=STYLES[style])
        with rig.experiment(STYLES[style]) as glue:
            scenario.run(glue)
        rig.join()
    assert "malformed" not in str(rig.log), "the last messages included"


def learn(glue: Experiment) -> Seen:
    """Let an agent learn; its actions depend on every number that it was ever shown."""
    glue.rl_init()
    seen: Seen = []
    for _ in range(10):
        seen += [glue.rl_episode(200), glue.rl_num_steps(), glue.rl_return()]
    glue.rl_cleanup()
    return seen


@pytest.mark.parametrize("originals", range(8), ids=lambda bits: f"{bits:03b}")
def test_a_mixture_of_ours_and_originals_gives_the_numbers_of_ours(rig: Rig, originals: int) -> None:
    # Without a seed from the experiment, which does not reach original programs.
    agents = [SarsaAgent(seed=1) for _ in range(2)]
    environments = [MinesEnvironment(random_start=True, seed=2) for _ in range(2)]
    for bit, player, style in ((1, agents[0], "java"), (2, environments[0], "python")):
        if originals & bit:
            rig.originals(player, style=STYLES[style])
        else:
            rig.ours(player)
    with rig.experiment() if originals & 4 else rig.native() as glue:
        seen = learn(glue)
    with local(agents[1], environments[1]) as glue:
        assert seen == learn(glue)


def test_every_order_of_joining_works_and_an_experiment_may_call_before_the_others_join(rig: Rig) -> None:
    for order in itertools.permutations((MirrorAgent, FiveStepEnvironment, None)):
        for player in order:
            if player is not None:
                rig.originals(player())
                continue
            glue = rig.experiment()
            glue.connection.send(Id.RL_INIT)
        assert glue.connection.receive() == (Id.RL_INIT, struct.pack(">I", 16) + b"sample task spec")
        assert glue.rl_episode(0) == 1
        glue.close()
        rig.join()


def test_half_steps_go_to_one_side_alone_and_leave_the_last_action_as_it_was(rig: Rig) -> None:
    calls: list[str] = []
    rig.ours(ScriptedAgent(calls), ScriptedEnvironment(calls=calls))
    glue = rig.experiment()
    assert glue.rl_init() == "a task"
    assert glue.rl_env_start() == Observation([0])
    assert glue.rl_agent_start(Observation([5])) == Action([105])
    assert glue.rl_env_step(Action([7], [0.5], b"x")) == Step(1.0, Observation([1]), False)
    assert (glue.rl_num_steps(), glue.rl_return(), glue.rl_num_episodes()) == (2, 1.0, 0)
    assert glue.rl_agent_step(-0.0, Observation([6])) == Action([106])
    assert glue.rl_step() == Step(1.0, Observation([2]), False, action=Action([102]))
    assert glue.rl_env_step(Action([8])) == Step(1.0, Observation([3]), True)
    glue.rl_agent_end(2.5)
    assert (glue.rl_num_steps(), glue.rl_return(), glue.rl_num_episodes()) == (3, 3.0, 1)
    assert calls[2:] == [
        "env_start",
        "agent_start [5]",
        "env_step [7]",
        "agent_step -0 [6]",
        "env_step []",
        "agent_step 1 [2]",
        "env_step [8]",
        "agent_end 2.5",
    ]


def test_players_of_ours_stay_when_an_original_experiment_leaves(rig: Rig) -> None:
    calls: list[str] = []
    rig.ours(ScriptedAgent(calls))
    rig.originals(FiveStepEnvironment())
    glue = rig.experiment()
    glue.rl_init()
    glue.close()
    rig.log.wait_for("was dismissed")
    rig.originals(FiveStepEnvironment())
    rig.experiment().rl_init()
    assert calls == ["agent_init sample task spec"] * 2


def test_an_episode_counts_as_steps_only_if_it_went_on_after_one(rig: Rig) -> None:
    environment = ScriptedEnvironment(length=1)
    rig.ours(ScriptedAgent(), environment)
    glue = rig.experiment()
    glue.rl_init()
    for length, max_steps, expected in ((1, 0, Action()), (2, 1, Action()), (2, 2, Action([100]))):
        environment.length = length
        glue.rl_episode(max_steps)
        environment.length = 1
        glue.rl_start()
        assert glue.rl_step().action == expected


def test_bytes_that_are_not_utf8_pass_unchanged(rig: Rig) -> None:
    rig.ours(SCENARIOS["test_message"].agent())
    assert rig.experiment().rl_agent_message("\udcff\udc80") == "\udcff\udc80"


def test_a_million_of_each_is_the_maximum_an_original_is_sent(rig: Rig) -> None:
    count = 1_000_000
    rig.originals(MirrorAgent())
    rig.ours(ScriptedEnvironment())
    with rig.native() as glue:
        action = glue.rl_agent_start(Observation([1] * count, [], b"c" * count))
        assert action.counts == (count, 0, count)
        with pytest.raises(PeerFailed, match="at most 1000000 of each"):
            glue.rl_agent_start(Observation(chars=bytes(count + 1)))
        # The agent was not at fault, and stays.
        assert glue.rl_agent_start(Observation(ints=[3])) == Action(ints=[3])


def test_original_programs_are_shown_neither_masks_nor_extras(rig: Rig) -> None:
    agent = Seeing(masks=True)
    rig.ours(Showing())
    rig.originals(agent)
    glue = rig.experiment()
    glue.rl_init()
    assert glue.rl_start().observation == BARE
    assert glue.rl_step().observation == BARE
    assert glue.rl_env_start() == BARE
    assert glue.rl_env_step(ACTION).observation == BARE
    assert agent.seen == [BARE] * 2
