"""An agent's time bank, by a clock set by hand; in the session, without sockets."""

from __future__ import annotations

import pytest

from glue.errors import ConfigError
from glue.hub.config import HubConfig, TimeLimits
from glue.hub.timing import TimeBank
from glue.wire.messages import ErrorCode, Kind, Role
from tests.clock import Clock
from tests.glue.hub.test_sessions import Rig, check_error

LIMITS = TimeLimits(step_seconds=1.0, bank_seconds=3.0, start_seconds=5.0, total_seconds=100.0)


class Timed:
    """A bank whose agent takes the given time for each answer, and of processors meanwhile."""

    def __init__(self, limits: TimeLimits = LIMITS, used: float | None = None) -> None:
        self.clock = Clock(1000.0)
        self.used = used
        self.reads = 0
        self.bank = TimeBank(limits, self.clock, self.read)

    def read(self) -> float | None:
        self.reads += 1
        return self.used

    def take(self, seconds: float, kind: Kind = Kind.AGENT_STEP, used: float = 0.0) -> str | None:
        self.bank.called(kind)
        self.clock.now += seconds
        if self.used is not None:
            self.used += used
        return self.bank.answered()


def test_each_answer_drains_what_it_takes_beyond_the_limit() -> None:
    timed = Timed()
    for _ in range(20):
        assert timed.take(1.0) is None  # the whole limit, and nothing of the bank
    assert timed.take(3.0) is None  # two of three seconds are gone
    assert timed.take(2.0) is None  # all three, exactly
    assert "bank of 3 s" in str(timed.take(1.25))


def test_time_between_an_answer_and_the_next_call_is_free() -> None:
    timed = Timed()
    timed.take(1.0)
    timed.clock.now += 1e6
    assert timed.bank.overdue() is None
    assert timed.take(1.0) is None


def test_several_processors_drain_what_they_use_together() -> None:
    timed = Timed(used=100.0)
    assert timed.take(0.5, used=2.0) is None  # 1 of 3 seconds
    assert timed.bank.left == (2.0, 98.0)
    assert "bank of 3 s" in str(timed.take(0.5, used=3.5))


def test_what_is_used_between_answers_counts() -> None:
    timed = Timed(used=0.0)
    timed.take(0.1, used=0.1)
    assert timed.used is not None
    timed.used += 2.5  # while the environment steps, or another entrant plays
    timed.take(0.1, used=0.1)
    bank, total = timed.bank.left
    assert bank == pytest.approx(3.0 - 1.6)
    assert total == pytest.approx(100.0 - 2.7)


def test_the_longer_of_both_times_counts_once() -> None:
    timed = Timed(used=0.0)
    timed.take(2.0, used=1.5)
    assert timed.bank.left == (2.0, 98.0)
    timed.take(1.5, used=2.0)
    assert timed.bank.left == (1.0, 96.0)


def test_what_is_used_to_initialise_does_not_count() -> None:
    timed = Timed(used=0.0)
    timed.take(4.0, Kind.AGENT_INIT, used=400.0)
    assert timed.take(0.5, used=0.5) is None
    assert timed.bank.left == (3.0, 99.5)


def test_quick_answers_are_read_together() -> None:
    timed = Timed(used=0.0)
    for _ in range(1000):
        timed.take(0.001, used=0.5)  # less than a second each: free
    assert timed.bank.left[0] == 3.0
    assert timed.reads <= 102


def test_without_a_reading_the_clock_counts_alone() -> None:
    timed = Timed(used=None)
    timed.take(2.0)
    timed.used = 50.0  # from now on it is known
    timed.take(1.0)
    assert timed.bank.left == (2.0, 97.0)


def test_an_agent_that_never_answers_is_overdue_when_the_bank_is_empty() -> None:
    timed = Timed()
    timed.take(2.0)
    timed.bank.called(Kind.AGENT_STEP)
    timed.clock.now += 3.0
    assert timed.bank.overdue() is None
    timed.clock.now += 0.25
    assert "bank" in str(timed.bank.overdue())


def test_a_call_sent_again_is_one_call() -> None:
    timed = Timed()
    assert timed.take(3.0) is None
    timed.clock.now += 50.0
    assert timed.bank.answered() is None  # no call is outstanding


def test_initialising_has_a_limit_of_its_own() -> None:
    timed = Timed()
    assert timed.take(2.0, Kind.AGENT_SEED) is None
    assert timed.take(3.0, Kind.AGENT_INIT) is None
    assert timed.take(4.0) is None  # the bank is untouched
    assert "initialise" in str(timed.take(0.25, Kind.AGENT_INIT))


def test_all_answers_together_have_a_limit() -> None:
    timed = Timed(TimeLimits(total_seconds=10.0))
    for _ in range(10):
        assert timed.take(1.0) is None
    assert "10 s in all" in str(timed.take(0.25))


@pytest.mark.parametrize("seconds", [-1.0, float("nan"), float("inf"), 1e9])
def test_a_limit_is_a_time(seconds: float) -> None:
    with pytest.raises(ConfigError, match="bank_seconds"):
        TimeLimits(bank_seconds=seconds)


@pytest.fixture
def timed() -> tuple[Rig, Clock]:
    """In the middle of an episode: the agent is asked for a step."""
    clock = Clock(1000.0)
    rig = Rig(HubConfig(heartbeat=1.0, timeout=5.0, time=LIMITS), clock)
    rig.fill()
    rig.carry_out(Kind.RL_INIT, 1, None)
    rig.ask(Kind.RL_EPISODE, 2, 0)
    assert [rig.answer(channel) for channel in "eae"] == [Kind.ENV_START, Kind.AGENT_START, Kind.ENV_STEP]
    return rig, clock


def test_a_slow_answer_is_the_last(timed: tuple[Rig, Clock]) -> None:
    rig, clock = timed
    clock.now += 3.0
    assert rig.answer("a") is Kind.AGENT_STEP
    assert rig.answer("e") is Kind.ENV_STEP
    clock.now += 3.0
    rig.received("x")
    assert rig.answer("a") is Kind.AGENT_STEP
    errors = [message for message in rig.received("x") if message.kind is Kind.ERROR]
    check_error(errors, ErrorCode.PEER_FAILED, "bank of 3 s is empty")
    assert [message.kind for message in rig.received("a")] == [Kind.GOODBYE]
    assert not rig.inbox.get("e")  # the late answer is not carried out


def test_an_agent_that_sleeps_is_dismissed_at_a_tick(timed: tuple[Rig, Clock]) -> None:
    rig, clock = timed
    rig.received("x")
    rig.received("a")
    clock.now += 4.0
    rig.tick(1.0)
    assert not rig.received("x")
    clock.now += 0.5
    rig.tick(1.0)
    assert Kind.ERROR in [message.kind for message in rig.received("x")]
    assert [message.kind for message in rig.received("a")] == [Kind.GOODBYE]


def test_a_call_whose_answer_nobody_needs_takes_no_time(timed: tuple[Rig, Clock]) -> None:
    rig, clock = timed
    rig.put("x", Kind.GOODBYE, 0, "interrupted")  # in the middle of a step
    rig.answer("a")
    clock.now += 1e4
    rig.tick(1.0)
    assert rig.received("a") == []
    assert Role.AGENT in rig.sessions._by_name["s"].peers


def test_the_environment_has_all_the_time(timed: tuple[Rig, Clock]) -> None:
    rig, clock = timed
    assert rig.answer("a") is Kind.AGENT_STEP
    clock.now += 1e4
    rig.tick(1.0)
    assert rig.answer("e") is Kind.ENV_STEP
    assert rig.answer("a") is Kind.AGENT_STEP
    assert Kind.ERROR not in [message.kind for message in rig.received("x")]


def test_without_limits_nothing_is_measured() -> None:
    clock = Clock(1000.0)
    rig = Rig(clock=clock)
    rig.fill()
    rig.ask(Kind.RL_INIT, 1, None)
    assert rig.answer("e") is Kind.ENV_INIT
    clock.now += 1e6
    rig.tick(1.0)
    assert rig.answer("a") is Kind.AGENT_INIT
    assert Role.AGENT in rig.sessions._by_name["s"].peers
