"""The glue in one process: the errors that a user's mistakes raise, and what may be left out or cut off."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest

from glue.engine.experiment import Experiment
from glue.engine.local import local
from glue.errors import ConfigError, LocalProtocolError, PeerFailed, Unsupported
from glue.options import build
from glue.roles import Agent, AgentLike
from glue.types import CUT_OFF, Action, Observation, Step
from tests.hubs import over_the_hub
from tests.players import ScriptedAgent, ScriptedEnvironment, failing

BOTH = pytest.mark.parametrize("glue", [local, over_the_hub])


def faulty(at: str, error: BaseException) -> ScriptedAgent:
    """Return an agent that raises `error` at a call."""
    return ScriptedAgent(before=failing(at, error))


class Answering(ScriptedEnvironment):
    """An environment that returns the given answers, by the names of its methods."""

    def __init__(self, **answers: Any) -> None:
        super().__init__()
        for name, answer in answers.items():
            setattr(self, name, lambda *_, answer=answer: answer)


def test_an_exception_of_the_agent_names_it_and_the_call_and_keeps_the_cause() -> None:
    cause = ValueError("no such thing")
    glue = local(faulty("agent_step", cause), ScriptedEnvironment())
    glue.rl_init()
    with pytest.raises(PeerFailed) as caught:
        glue.rl_episode()
    assert str(caught.value) == "agent ScriptedAgent raised in agent_step: ValueError: no such thing"
    assert caught.value.__cause__ is cause


def test_a_glue_error_of_a_player_is_its_failure_too() -> None:
    glue = local(faulty("agent_init", LocalProtocolError("ints must be whole")), ScriptedEnvironment())
    with pytest.raises(PeerFailed, match="agent ScriptedAgent raised in agent_init: ints must be whole"):
        glue.rl_init()


@BOTH
@pytest.mark.parametrize(("limits", "taken"), [((0,), 3), ((2, 3, 0), 3), ((2, 3), 2)])
def test_an_episode_continues_to_each_limit_and_without_one_to_its_end(
    glue: Callable[[Agent, ScriptedEnvironment], Experiment], limits: tuple[int, ...], taken: int
) -> None:
    environment = ScriptedEnvironment(length=3)
    with glue(ScriptedAgent(), environment) as experiment:
        experiment.rl_init()
        experiment.rl_start()
        ends = [experiment.rl_go_on(limit) for limit in limits]
        assert ends == [True if limit == 0 else None for limit in limits]
    assert sum(call.startswith("env_step") for call in environment.calls) == taken


def test_an_interrupt_passes_through() -> None:
    glue = local(faulty("agent_step", KeyboardInterrupt()), ScriptedEnvironment())
    glue.rl_init()
    with pytest.raises(KeyboardInterrupt):
        glue.rl_episode()
    assert glue.rl_num_steps() == 2, "the experiment can still be asked"


@pytest.mark.parametrize(
    ("answers", "complaint"),
    [
        ({"env_init": 5}, r"env_init of Answering must return a str; it returned int 5"),
        ({"env_start": None}, "env_start of Answering must return an Observation; it returned NoneType None"),
        ({"env_start": Action()}, r"must return an Observation; it returned Action Action\(\)"),
        ({"env_step": None}, r"must return Step\(reward, observation, terminal\); it returned NoneType None"),
        ({"env_step": (1.0, Observation())}, r"must return Step\(reward, observation, terminal\)"),
        ({"env_step": ("high", Observation(), False)}, r"must return Step\(reward, observation, terminal\)"),
        ({"env_step": (1.0, [0], False)}, r"must return a Step with an Observation; .* \[0\]"),
        (
            {"env_step": (1.0, Observation(), "no")},
            r"must return Step\(reward, observation, terminal\); .* 'no'",
        ),
        ({"env_step": (1.0, Observation(), {})}, r"must return Step\(reward, observation, terminal\); .* {}"),
        ({"env_step": (10**400, Observation(), True)}, r"must return Step\(reward, observation, terminal\)"),
        ({"env_message": b"bytes"}, "env_message of Answering must return a str"),
    ],
)
def test_a_wrong_answer_says_what_was_expected_and_what_came(answers: dict[str, Any], complaint: str) -> None:
    glue = local(ScriptedAgent(), Answering(**answers))
    with pytest.raises(PeerFailed, match=complaint):
        (glue.rl_init(), glue.rl_env_message("?"), glue.rl_episode())


@pytest.mark.parametrize(
    ("terminal", "expected"),
    [(1, True), (0, False), (2, True), (np.bool_(True), True), (np.int32(0), False), (np.False_, False)],
)
def test_terminal_may_be_a_number_or_of_numpy(terminal: Any, expected: bool) -> None:
    glue = local(ScriptedAgent(), Answering(env_step=(1.0, Observation(), terminal)))
    glue.rl_init()
    glue.rl_start()
    assert glue.rl_step().terminal is expected


@pytest.mark.parametrize("method", ["agent_start", "agent_step"])
def test_an_observation_returned_as_an_action_is_a_wrong_answer(method: str) -> None:
    agent = ScriptedAgent()
    setattr(agent, method, lambda *received: received[-1])
    glue = local(agent, ScriptedEnvironment())
    glue.rl_init()
    with pytest.raises(PeerFailed, match=f"{method} of ScriptedAgent must return an Action"):
        glue.rl_episode()


def test_missing_methods_are_named_with_and_without_the_base_class() -> None:
    class Half:
        def agent_init(self, task_spec: str) -> None: ...

    class Derived(Agent):
        def agent_start(self, observation: Observation) -> Action:
            return Action()

    with pytest.raises(PeerFailed, match=r"Half is not an agent: it has no agent_start, agent_step$"):
        local(Half(), ScriptedEnvironment())  # type: ignore[arg-type]
    with pytest.raises(TypeError, match="agent_step"):
        Derived()  # type: ignore[abstract]
    with pytest.raises(ConfigError, match="Derived has no agent_step"):
        build(Derived, {})


class Plain:
    """An agent without the base class, with the required methods only."""

    def agent_start(self, observation: Observation) -> Action:
        return Action(observation.ints)

    def agent_step(self, reward: float, observation: Observation) -> Action:
        return Action(observation.ints)


class Based(Plain, Agent):
    """The same with the base class."""


class Countdown:
    """An environment without the base class, which returns `answer` as the result of its second step."""

    def __init__(self, answer: Any) -> None:
        self.answers = [answer, Step(1.0, Observation([1]), False)]

    def env_init(self) -> str:
        return ""

    def env_start(self) -> Observation:
        return Observation([0])

    def env_step(self, action: Action) -> Step:
        answer: Step = self.answers.pop()
        return answer


@pytest.mark.parametrize("agent", [Plain, Based])
@pytest.mark.parametrize(
    ("answer", "truncated"),
    [
        ((1.0, Observation([2]), True), False),
        ((1.0, Observation([2]), 1), False),
        ((1.0, Observation([2]), CUT_OFF), True),
        (Step(1, Observation([2]), True), False),
        (Step(1.0, Observation([2]), False, True), True),
        (Step(1.0, Observation([2]), True, True), True),
    ],
)
@BOTH
def test_optional_methods_may_be_left_out(
    glue: Callable[..., Any], agent: Callable[[], AgentLike], answer: Any, truncated: bool
) -> None:
    with glue(agent(), Countdown(answer)) as experiment:
        experiment.rl_init()
        experiment.rl_start()
        assert experiment.rl_step() == Step(1.0, Observation([1]), False, False, Action([1]))
        taken = experiment.rl_step()
        assert taken == Step(1.0, Observation([2]), True, truncated, Action([2 if truncated else 1]))
        assert type(taken.terminal) is bool
        assert (experiment.rl_num_episodes(), experiment.rl_num_steps()) == ((0, 3) if truncated else (1, 2))
        assert (experiment.rl_agent_message("?"), experiment.rl_env_message("?")) == ("", "")
        experiment.rl_cleanup()


@BOTH
def test_at_a_cut_off_the_agent_gets_the_last_observation_and_no_end(glue: Callable[..., Any]) -> None:
    agent, environment = ScriptedAgent(), ScriptedEnvironment()
    with glue(agent, environment) as experiment:
        experiment.rl_init()
        assert experiment.rl_episode() is True
        assert (experiment.rl_num_steps(), experiment.rl_num_episodes()) == (3, 1)
        agent.calls.clear()
        environment.cuts = True
        assert experiment.rl_episode() is False
        assert agent.calls == ["agent_start [0]", *(f"agent_step 1 [{step}]" for step in (1, 2, 3))]
        assert (experiment.rl_num_steps(), experiment.rl_num_episodes()) == (4, 1)
        assert experiment.rl_return() == 3.0


def test_saving_what_cannot_be_saved_is_unsupported() -> None:
    glue = local(ScriptedAgent(), ScriptedEnvironment())
    with pytest.raises(Unsupported, match="agent ScriptedAgent does not support this: it has no agent_save"):
        glue.rl_agent_save()
    with pytest.raises(Unsupported, match=r"environment ScriptedEnvironment .* no env_load"):
        glue.rl_env_load(b"")
    assert glue.rl_init() == "a task"


# Arguments of an experiment's verbs


@pytest.fixture(params=[local, over_the_hub], ids=["local", "hub"])
def experiment(request: pytest.FixtureRequest) -> Iterator[Experiment]:
    with request.param(ScriptedAgent(), ScriptedEnvironment()) as experiment:
        yield experiment


MISTAKES: list[tuple[Callable[[Any], object], str]] = [
    (lambda glue: glue.rl_episode(-1), r"a step limit must be from 0 to 2\^32 - 1, not -1"),
    (lambda glue: glue.rl_episode(2**32), r"a step limit must be from 0 to 2\^32 - 1, not 4294967296"),
    (lambda glue: glue.rl_episode(1e3), r"a step limit must be a whole number, not 1000\.0"),
    (lambda glue: glue.rl_init(-1), r"a seed must be from 0 to 2\^63 - 1, not -1"),
    (lambda glue: glue.rl_init(2**63), r"a seed must be from 0 to 2\^63 - 1"),
    (lambda glue: glue.rl_init("lucky"), "a seed must be a whole number, not 'lucky'"),
    (lambda glue: glue.rl_agent_message(5), "type str, not 5"),
    (lambda glue: glue.rl_env_message(None), "type str, not None"),
    (lambda glue: glue.rl_env_step(Observation()), r"type Action, not Observation\(\)"),
    (lambda glue: glue.rl_agent_start(Action()), r"type Observation, not Action\(\)"),
    (lambda glue: glue.rl_agent_step(0.0, 7), "type Observation, not 7"),
    (lambda glue: glue.rl_agent_load("text"), "type bytes, not 'text'"),
    (lambda glue: glue.rl_env_load(None), "type bytes, not None"),
]


def test_a_mistake_is_answered_at_once_and_the_session_goes_on(experiment: Experiment) -> None:
    experiment.rl_init()
    for mistake, complaint in MISTAKES:
        with pytest.raises(LocalProtocolError, match=complaint):
            mistake(experiment)
    assert not experiment.rl_episode(3)
    assert experiment.rl_num_steps() == 3


def test_largest_seed_and_limit_are_accepted(experiment: Experiment) -> None:
    assert experiment.rl_init(2**63 - 1) == "a task"
    assert experiment.rl_episode(2**32 - 1)


class Keeping(ScriptedAgent):
    saved = b"its own"

    def agent_save(self) -> bytes:
        return self.saved

    def agent_load(self, data: bytes) -> None:
        self.saved = data


class KeepingEnvironment(ScriptedEnvironment):
    cuts = True
    saved = b"its"

    def env_save(self) -> bytes:
        return self.saved

    def env_load(self, data: bytes) -> None:
        self.saved = data


@BOTH
def test_half_steps_and_saves_reach_the_players(glue: Callable[..., Any]) -> None:
    with glue(Keeping(), KeepingEnvironment(length=2)) as experiment:
        experiment.rl_init()
        assert experiment.rl_env_start() == Observation([0])
        assert experiment.rl_agent_start(Observation([0])) == Action([100])
        assert experiment.rl_env_step(Action([100])) == Step(1.0, Observation([1]), False, False)
        assert experiment.rl_agent_step(1.0, Observation([1])) == Action([101])
        assert experiment.rl_env_step(Action([101])) == Step(1.0, Observation([2]), True, True)
        for saved in ((b"its own", b"its"), (b"an agent's", b"another's")):
            assert (experiment.rl_agent_save(), experiment.rl_env_save()) == saved
            experiment.rl_agent_load(b"an agent's")
            experiment.rl_env_load(b"another's")


def test_numbers_may_be_of_numpy(experiment: Experiment) -> None:
    assert experiment.rl_init(seed=np.int64(7)) == "a task"  # type: ignore[arg-type]
    assert not experiment.rl_episode(np.uint32(2))  # type: ignore[arg-type]
    assert experiment.rl_num_steps() == 2
