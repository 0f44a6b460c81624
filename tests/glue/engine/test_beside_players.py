"""Masks and extras from the environment to the agent and the experiment, wherever the players are."""

from __future__ import annotations

from contextlib import AbstractContextManager
from typing import Any

import pytest

import glue
from glue.client.experiment import RemoteExperiment
from glue.engine.calls import environment_calls
from glue.engine.checking import CheckedActions
from glue.engine.local import local
from glue.errors import ConfigError, PeerFailed
from glue.extras import Extra
from glue.pace import Pace
from glue.plugins.batched import BatchedEnvironments
from glue.roles import Agent, Environment, MaskAgent, capabilities, offers
from glue.types import Action, Observation, Step
from glue.wire.messages import Kind
from tests.glue.client.dialogue import Dialogue, Script, experiment
from tests.hubs import hub_with, over_the_hub

SPEC = (
    "VERSION RL-Glue-3.0 PROBLEMTYPE episodic DISCOUNTFACTOR 1.0 OBSERVATIONS INTS (0 9) "
    "ACTIONS INTS (0 2) (5 6) REWARDS (0 1) EXTRA masks"
)
MASK = [True, False, True, False, True]
EXTRAS: dict[str, Extra] = {"steps": 1, "why": "none"}
FULL = Observation([7], mask=MASK, extras=EXTRAS)


ACTION = Action([0, 6])


class Showing(Environment):
    """Shows the same observation in each step."""

    env_masks = True
    env_extras = True

    def __init__(self, observation: Observation = FULL, spec: str = SPEC) -> None:
        self.observation = observation
        self.spec = spec

    def env_init(self) -> str:
        return self.spec

    def env_start(self) -> Observation:
        return self.observation

    def env_step(self, action: Action) -> Step:
        return Step(0.5, self.observation, False)


class Seeing(Agent):
    """Keeps the observations that it receives."""

    def __init__(self, masks: bool) -> None:
        self.agent_masks = masks
        self.seen: list[Observation] = []

    def agent_start(self, observation: Observation) -> Action:
        self.seen.append(observation)
        return ACTION

    def agent_step(self, reward: float, observation: Observation) -> Action:
        return self.agent_start(observation)


def inside_the_hub(agent: Any, environment: Any) -> AbstractContextManager[Any]:
    return glue.host(agent, environment, bind="tcp://127.0.0.1:*")


@pytest.mark.parametrize("topology", [local, over_the_hub, inside_the_hub])
@pytest.mark.parametrize("masks", [False, True])
def test_agents_never_see_extras_and_masks_only_with_the_capability(topology: Any, masks: bool) -> None:
    agent = Seeing(masks)
    with topology(agent, Showing()) as experiment:
        experiment.rl_init()
        start = experiment.rl_start()
        step = experiment.rl_step()
        assert experiment.rl_env_step(Action([0, 5])).observation == FULL
        experiment.rl_agent_start(FULL)
        experiment.rl_agent_step(0.5, FULL)
        experiment.rl_episode(max_steps=3)
    assert start.observation == step.observation == FULL
    assert set(agent.seen) == {FULL.without(mask=not masks, extras=True)}
    assert len(agent.seen) == 7


def test_capabilities_are_attributes_of_class_or_object() -> None:
    assert capabilities(Showing()) == ("extras", "mask", "truncate")
    assert capabilities(Seeing(masks=True)) == ("mask",)
    assert capabilities(Seeing(masks=False)) == ()
    assert not offers(object(), MaskAgent)


@pytest.mark.parametrize(
    ("observation", "spec", "words"),
    [
        (
            Observation([7], mask=[True] * 9),
            SPEC,
            "5 values fill 1 byte of mask, the spare bits zero, not 0xff01",
        ),
        (Observation([7], mask=[False] * 3 + [True] * 2), SPEC, "no value of int 0 is legal"),
        (Observation([7], mask=[True] * 4), SPEC, "it is of 4 values, and the ints of an action have 5"),
        (FULL, SPEC.replace("EXTRA masks", "EXTRA"), "the word masks in EXTRA"),
        (FULL, SPEC.replace("(0 2)", "(0 POSINF)"), "bounds of an int"),
        (Observation([7, 8], mask=MASK), SPEC, "must return 1 int.*2 ints"),
    ],
)
def test_a_wrong_mask_is_reported_where_it_was_made(observation: Observation, spec: str, words: str) -> None:
    with local(Seeing(True), Showing(observation, spec)) as experiment:
        experiment.rl_init()
        with pytest.raises(PeerFailed, match=f"env_start of Showing.*({words})"):
            experiment.rl_start()


def test_a_mask_that_was_received_may_be_passed_on() -> None:
    assert FULL.mask is not None
    assert len(FULL.mask) == 8
    with local(Seeing(True), Showing(Observation([7], mask=FULL.mask), SPEC)) as experiment:
        experiment.rl_init()
        assert experiment.rl_start().observation == FULL.without()


@pytest.mark.parametrize(("attribute", "what"), [("env_masks", "mask"), ("env_extras", "extras")])
@pytest.mark.parametrize("spec", [SPEC, "a task"])
def test_what_is_not_offered_is_refused_where_it_was_made(attribute: str, what: str, spec: str) -> None:
    environment = Showing(FULL, spec)
    setattr(environment, attribute, False)
    calls = environment_calls(environment)
    calls[Kind.ENV_INIT]((), None)
    with pytest.raises(PeerFailed, match=f"with {what}, and does not offer this capability"):
        calls[Kind.ENV_STEP]((), Action([0, 5]))


def test_a_batch_carries_no_masks_and_leaves_extras_out() -> None:
    with pytest.raises(ConfigError, match="a batch of games carries no masks"):
        BatchedEnvironments([Showing()])
    only_extras = Showing(FULL.without(mask=True, extras=False))
    only_extras.env_masks = False
    batch = BatchedEnvironments([only_extras] * 2)
    batch.env_init()
    assert batch.env_start().extras == {}


# A hub of an older version


def test_an_experiment_sends_an_older_hub_no_mask() -> None:
    def older(hub: Dialogue) -> Script:
        request = yield Kind.RL_AGENT_START
        assert request.body == Observation([7]).body
        hub.say(Kind.RL_AGENT_START, request.seq, body=Action([1]).body)

    def verbs(glue: RemoteExperiment) -> Action:
        return glue.rl_agent_start(FULL)

    assert experiment(older, verbs) == Action([1])


# Actions that are checked


@pytest.mark.parametrize(
    ("action", "words"),
    [
        (Action([1, 6]), r"int 0 is 1, and the mask of the values from 0 on is 101"),
        (Action([0, 5]), r"int 1 is 5, and the mask of the values from 5 on is 01"),
        (Action([0, 7]), r"int 1 is 7, not in \(5 6\)"),
        (Action([0]), "ints: 2 expected, 1 received"),
    ],
)
def test_an_illegal_action_is_refused_with_the_mask(action: Action, words: str) -> None:
    environment = CheckedActions(Showing())
    environment.env_init()
    environment.env_start()
    environment.env_step(Action([2, 6]))
    with pytest.raises(PeerFailed, match=rf"the agent's Action\(.*\) is illegal: {words}"):
        environment.env_step(action)


def test_without_a_mask_or_a_known_task_every_action_is_passed_on() -> None:
    for environment in (Showing(FULL.without(mask=True)), Showing(FULL, "a task")):
        checked = CheckedActions(environment)
        checked.env_init()
        checked.env_start()
        assert checked.env_step(Action([1, 5])).reward == 0.5
    assert capabilities(CheckedActions(Showing())) == capabilities(Showing())
    with pytest.raises(ConfigError, match="many games at once"):
        CheckedActions(BatchedEnvironments([Plain()]))


def test_actions_are_checked_only_at_a_hub_that_waits() -> None:
    for pace in (Pace(rate=10.0), Pace(delay=1)):
        with (
            hub_with(pace=pace) as url,
            pytest.raises(ConfigError, match=r"Showing cannot check actions here: .* a rate"),
        ):
            glue.serve_environment(CheckedActions(Showing()), url)
    with over_the_hub(Seeing(masks=False), CheckedActions(Showing())) as connected:
        connected.rl_init()
        assert connected.rl_start().observation.packed_mask == FULL.packed_mask


class Plain(Showing):
    """Shows nothing beside its observation."""

    env_masks = False
    env_extras = False
