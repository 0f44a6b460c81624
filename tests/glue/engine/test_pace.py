"""An environment that does not wait, in one process, where only the agent's time passes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from fractions import Fraction
from typing import Any

import numpy as np
import pytest

from agents.baselines import RandomAgent
from env_server.toys import MinesEnvironment
from glue.engine.engine import Instruction
from glue.engine.experiment import Experiment
from glue.engine.local import LocalExperiment, local
from glue.engine.pacer import Pacer
from glue.errors import ConfigError, PeerFailed, Unsupported
from glue.pace import Pace
from glue.types import Action
from glue.wire.messages import Kind
from tests.clock import Clock
from tests.hubs import over_the_hub
from tests.players import ScriptedAgent, ScriptedEnvironment


class Thinking(ScriptedAgent):
    """An agent that takes the given seconds for its answers, one after the other, and none for the rest."""

    def __init__(self, clock: Clock, calls: list[str], seconds: Sequence[float]) -> None:
        super().__init__(calls)
        self._clock = clock
        self._seconds = list(seconds)

    def _note(self, call: str) -> None:
        super()._note(call)
        if call.startswith(("agent_start", "agent_step")) and self._seconds:
            self._clock.now += self._seconds.pop(0)


class Told(Thinking):
    """One that notes how much time it has."""

    def agent_pace(self, deadline: float, latency: float) -> None:
        self._note(f"agent_pace {deadline:g} {latency:g}")


def begun(
    pace: Pace, *seconds: float, agent: type[Thinking] = Thinking, length: int = 4
) -> tuple[LocalExperiment, list[str]]:
    """Return an experiment after RL_init whose agent takes these times, and the list of its further calls."""
    clock, calls = Clock(), list[str]()
    glue = local(
        agent(clock, calls, seconds), ScriptedEnvironment(length, 1.0, calls), pace=pace, clock=clock
    )
    glue.rl_init()
    calls.clear()
    return glue, calls


def test_a_late_agents_last_action_is_repeated_and_it_misses_nothing_but_time() -> None:
    glue, calls = begun(Pace(rate=1.0), 5.0, 0.5, 2.5)
    assert glue.rl_episode()
    assert calls == [
        "env_start",
        "agent_start [0]",  # until 5 s, when the first step is due
        "env_step [100]",
        "agent_step 1 [1]",  # until 5.5 s
        "env_step [101]",  # at 6 s
        "agent_step 1 [2]",  # until 8.5 s
        "env_step [101]",  # at 7 s, late
        "env_step [101]",  # at 8 s, late; the episode ends
        "agent_end 2",  # of both steps
    ]
    assert (glue.late_actions(), glue.rl_return(), glue.rl_num_steps()) == (2, 4.0, 4)


def test_a_late_agent_is_given_the_newest_observation_and_all_rewards() -> None:
    glue, calls = begun(Pace(rate=1.0), 0.0, 2.5, 0.9, length=9)
    glue.rl_start()
    assert [glue.rl_step().action for _ in range(4)] == [Action([n]) for n in (100, 100, 101, 104)]
    assert calls[2:] == [
        "env_step [100]",
        "agent_step 1 [1]",  # until 2.5 s
        "env_step [100]",  # at 1 s
        "env_step [100]",  # at 2 s
        "agent_step 2 [3]",  # at 2.5 s, until 3.4 s
        "env_step [101]",  # at 3 s
        "agent_step 1 [4]",  # at 3.4 s
    ]
    assert glue.late_actions() == 3


def test_a_named_action_takes_the_place_of_one_that_is_late() -> None:
    glue, calls = begun(Pace(rate=1.0, late="7"), 0.0, 2.5, length=5)
    glue.rl_episode()
    made = [call for call in calls if call.startswith("env_step")]
    assert made == [f"env_step [{action}]" for action in (100, 7, 7, 103, 104)]


def test_an_agent_is_told_its_deadline_and_its_latency() -> None:
    glue, calls = begun(Pace(rate=4.0), 3.0, 0.125, 0.7, agent=Told, length=6)
    glue.rl_episode()
    told = [call for call in calls if call.startswith("agent_pace")]
    assert told == ["agent_pace 0.25 3", "agent_pace 0.25 0.125", "agent_pace 0.05 0.7", "agent_pace 0.25 0"]


def test_an_agent_is_told_nothing_where_the_environment_waits() -> None:
    for pace in (Pace(), Pace(delay=1)):
        glue, calls = begun(pace, agent=Told)
        glue.rl_episode()
        assert not [call for call in calls if call.startswith("agent_pace")]


def test_where_the_environment_waits_no_number_of_late_actions_is_known() -> None:
    """As over a hub, so that results are the same however the players are started."""
    with local(RandomAgent(), MinesEnvironment()) as glue:
        glue.rl_init()
        glue.rl_episode(3)
        assert glue.late_actions() is None


def test_a_message_waits_for_the_answer_of_a_late_agent() -> None:
    glue, calls = begun(Pace(rate=1.0), 0.0, 2.5, length=9)
    glue.rl_start()
    glue.rl_step()
    glue.rl_step()
    del calls[:]
    assert glue.rl_agent_message("well?") == "agent heard well?"
    assert calls == ["agent_step 1 [2]", "agent_message well?"]  # first what it has not seen yet


def test_the_next_start_waits_for_the_answer_of_a_late_agent() -> None:
    glue, calls = begun(Pace(rate=1.0), 0.0, 2.5, length=9)
    assert not glue.rl_episode(3)  # two steps, both of them late
    assert glue.late_actions() == 2
    glue.rl_start()
    assert calls[-3:] == ["env_start", "agent_step 1 [2]", "agent_start [0]"]
    assert glue.late_actions() == 0


@pytest.mark.parametrize(
    ("pace", "made"),
    [
        (Pace(delay=2), [100, 100, 100, 101, 102, 103]),
        (Pace(delay=2, late="7"), [100, 7, 7, 101, 102, 103]),
        (Pace(delay=1, rate=1.0), [100, 100, 101, 102, 103, 104]),
    ],
)
def test_a_delayed_action_is_carried_out_so_many_steps_later(pace: Pace, made: list[int]) -> None:
    for _ in range(2):  # nothing is left from one episode to the next
        glue, calls = begun(pace, length=6)
        glue.rl_episode()
        assert [call for call in calls if call.startswith("env_step")] == [f"env_step [{a}]" for a in made]
        assert [call for call in calls if call.startswith("agent_step")][:1] == ["agent_step 1 [1]"]
        assert glue.late_actions() == 0


def test_a_delayed_action_that_is_late_counts_when_it_is_carried_out() -> None:
    glue, _ = begun(Pace(rate=1.0, delay=2), 0.0, 1.5, length=9)
    glue.rl_start()
    counts = []
    for _ in range(4):
        glue.rl_step()
        counts.append(glue.late_actions())
    assert counts == [0, 0, 1, 1]  # at 1 s nothing has been answered


def test_half_steps_have_the_same_pace() -> None:
    glue, _ = begun(Pace(rate=1.0), 0.0, 1.5)
    glue.rl_start()
    observation = glue.rl_env_step(Action([1])).observation
    assert glue.rl_agent_step(1.0, observation) == Action([100])  # late
    assert glue.late_actions() == 1


def test_after_a_failure_a_new_episode_can_begin() -> None:
    glue, calls = begun(Pace(rate=1.0), 0.0, 1.5)
    glue.rl_start()
    glue._handlers[Kind.ENV_STEP] = lambda scalars, action: 1 / 0  # type: ignore[assignment, return-value]
    with pytest.raises(PeerFailed, match="ZeroDivisionError"):
        glue.rl_step()
    del calls[:]
    glue.rl_start()
    assert calls == ["env_start", "agent_start [0]"]


def test_many_games_at_once_have_no_pace() -> None:
    environment = MinesEnvironment()
    environment.env_batch = lambda: 2  # type: ignore[attr-defined]
    with pytest.raises(Unsupported, match=r"many games at once .* has no rate and no delay"):
        local(RandomAgent(), environment, pace=Pace(delay=1)).rl_init()


@pytest.mark.parametrize("glue", [local, over_the_hub])
@pytest.mark.parametrize(("late", "wrong"), [("9", "9"), ("1,1", "2"), ("0.5", "double")])
def test_an_illegal_action_in_place_of_late_ones_is_refused(
    glue: Callable[..., AbstractContextManager[Experiment]], late: str, wrong: str
) -> None:
    with (
        glue(RandomAgent(), MinesEnvironment(), pace=Pace(delay=1, late=late)) as experiment,
        pytest.raises(Unsupported, match=f"in place of late ones, {late}, is illegal: .*{wrong}"),
    ):
        experiment.rl_init()


def test_an_agent_has_half_a_period_even_if_the_environment_is_behind() -> None:
    pacer = Pacer(Pace(rate=10.0), Action(), None)
    step = Instruction(Kind.AGENT_STEP, (1.0,), "an observation")
    pacer.call(Instruction(Kind.AGENT_START, (), "an observation"), 0.0)
    pacer.next_call(0.0, told=False)
    assert pacer.answered(Kind.AGENT_START, (), "first", 1.0) == ((), "first")
    pacer.call(step, 1.05)
    assert pacer.deadline == pytest.approx(1.1)
    pacer.due()
    pacer.call(step, 1.35)  # it took a quarter of a second
    assert pacer.deadline == pytest.approx(1.4)


@pytest.mark.parametrize(
    ("wrong", "why"),
    [
        *(({"rate": rate}, "a rate is from 0") for rate in (-1.0, 2000.0, float("nan"), "5", None, True)),
        *(({"delay": delay}, "a delay is from 0") for delay in (-1, 1.5, "2", True)),
        ({"rate": -1.0, "late": "1"}, "a rate is from 0"),
        *(
            ({"rate": 1.0, "late": late}, r"late is `repeat`, or the numbers of an action, as in 0,1,0")
            for late in (
                "",
                "now",
                "1,",
                "1 2",
                "3000000000",
                "nan",
                "1e5",
                "1_0",
                "-2147483649",
                [0, 1],
                b"1",
            )
        ),
        ({"late": "1"}, "give a rate or a delay, too"),
    ],
)
def test_what_is_no_pace_is_refused(wrong: dict[str, Any], why: str) -> None:
    with pytest.raises(ConfigError, match=why):
        Pace(**wrong)


@pytest.mark.parametrize(
    ("rate", "delay"), [(np.float32(100), np.int64(3)), (np.float16(100), np.int8(3)), (Fraction(100), 3)]
)
def test_a_pace_has_pythons_numbers(rate: Any, delay: Any) -> None:
    pace = Pace(rate=rate, delay=delay)
    assert repr(pace) == repr(Pace(rate=100.0, delay=3))
    assert str(pace) == ", 100 steps per second, actions delayed by 3 steps"


def test_a_late_action_has_whole_numbers_and_decimals() -> None:
    assert Pace(rate=1.0, late="0,1").action == Action([0, 1])
    assert Pace(rate=1.0, late="-2,0.5,-1.0").action == Action([-2], [0.5, -1.0])
    assert Pace(rate=1.0, late="-2147483648").action == Action([-(2**31)])
    assert Pace(rate=1.0).action is None
