"""Turns, quotas and the state of attempts, from made-up journals."""

from __future__ import annotations

from collections import Counter
from datetime import UTC, datetime, timedelta
from zoneinfo import ZoneInfo

import pytest
from hypothesis import given
from hypothesis import strategies as st

from experiment_runner.competition.records import journal
from experiment_runner.competition.records.journal import EVERYBODY, act
from experiment_runner.competition.season.schedule import left, next_attempts, queue, request, returns_at
from glue.errors import ExperimentError
from tests.experiment_runner.competition.season.made import FILE, Made

NAMES = ("ann", "bob", "cy")


def made(more: str = "") -> Made:
    """Return a season with further settings."""
    return Made(NAMES, FILE.replace("[season]", f"[season]\n{more}"))


def ask(season: Made, name: str) -> None:
    """Let an entrant ask for an attempt."""
    season.acts.append(request(season.state, name, season.now))


def chosen(season: Made) -> list[tuple[str, int]]:
    return [(one.entrant, one.number) for one in next_attempts(season.state, season.now)]


def test_a_thousand_attempts_of_one_delay_another_by_one() -> None:
    season = made("attempts_per_day = 1000\nmost_waiting = 999")
    for number in range(1, 1001):
        season.act(journal.REQUEST, "ann", number=number)
    assert chosen(season) == [("ann", 1)]
    season.act(journal.START, "ann", number=1)
    ask(season, "bob")
    assert chosen(season) == []  # one slot
    season.act(journal.OVER, "ann", number=1)
    assert chosen(season) == [("bob", 1)]
    assert queue(season.state)[1].number == 2
    with pytest.raises(ExperimentError, match="wait already"):
        ask(season, "ann")


def test_attempts_that_are_left_while_they_wait_have_an_end() -> None:
    season = made("attempts_per_day = 1")
    state = season.state
    for number in range(1, 101):
        state.apply(request(state, "ann", season.now))
        state.apply(act(journal.CANCEL, "ann", "", now=season.now, number=number))
    with pytest.raises(ExperimentError, match="ann has left 100 attempts of today"):
        request(state, "ann", season.now)
    assert request(state, "bob", season.now).number == 1
    assert request(state, "ann", season.now + timedelta(days=1)).number == 101


_WISHES = st.lists(
    st.tuples(st.sampled_from(["ask", "start", "over", "ours"]), st.sampled_from(NAMES)), max_size=60
)


@given(_WISHES, st.integers(1, 3))
def test_turns_are_fair_and_an_entrant_plays_one_attempt_at_a_time(
    wishes: list[tuple[str, str]], parallel: int
) -> None:
    season = made(f"parallel = {parallel}\nattempts_per_day = 100\nmost_waiting = 100")
    state = season.state
    starts: list[tuple[str, int]] = []
    ended: dict[str, int] = {}
    for what, name in wishes:
        playing = state.entrants[name].playing
        if what == "ask":
            state.apply(request(state, name, season.now))
        elif what == "start":
            for one in next_attempts(state, season.now):
                state.apply(act(journal.START, one.entrant, "", now=season.now, number=one.number))
                starts.append((one.entrant, state.count))
        elif playing is not None:
            state.apply(act(what, name, "", now=season.now, number=playing.number))
            ended[name] = state.count
        running = [one.entrant for one in state.attempts("playing")]
        assert len(running) == len(set(running)) <= parallel
        for one in state.attempts("waiting"):
            if one.entrant in running or one != state.entrants[one.entrant].waiting[0]:
                continue  # it waits for its own entrant
            from_then = max(one.order, ended.get(one.entrant, 0))
            since = [name for name, order in starts if order > from_then and name != one.entrant]
            assert max(Counter(since).values(), default=0) <= 1 + (
                state.entrants[one.entrant].served > one.order
            )


def test_nobody_plays_during_a_pause_or_before_the_season() -> None:
    season = made()
    ask(season, "ann")
    ask(season, "bob")
    season.act(journal.PAUSE, "ann", "three forfeits")
    assert chosen(season) == [("bob", 1)]
    season.act(journal.PAUSE, EVERYBODY, "maintenance")
    assert chosen(season) == []
    season.act(journal.RESUME, EVERYBODY, "it is done")
    season.act(journal.RESUME, "ann", "it has a new image")
    assert chosen(season) == [("ann", 1)]
    assert next_attempts(season.state, datetime(2026, 11, 30, tzinfo=UTC)) == []
    assert next_attempts(season.state, datetime(2026, 12, 20, tzinfo=UTC))  # what waits is still played


def test_a_day_ends_at_midnight_in_the_time_zone_of_the_season() -> None:
    season = made('attempts_per_day = 2\nzone = "America/New_York"')
    season.now = datetime(2026, 12, 2, 4, 0, tzinfo=UTC)  # 23:00 of the day before
    for _ in range(2):
        ask(season, "ann")
    state = season.state
    assert left(state, state.entrants["ann"], season.now) == 0
    midnight = datetime(2026, 12, 2, tzinfo=ZoneInfo("America/New_York"))
    assert returns_at(state, season.now) == midnight
    with pytest.raises(
        ExperimentError, match="used its 2 attempts of today; the next day begins at 2026-12-02 00:00"
    ):
        ask(season, "ann")
    assert left(state, state.entrants["ann"], midnight) == 2
    assert left(state, state.entrants["ann"], midnight - timedelta(days=1)) == 0  # the clock was set back
    assert returns_at(state, datetime(2026, 12, 19, 12, tzinfo=UTC)) is None


def test_what_is_not_the_entrants_fault_costs_nothing_and_grants_are_used_last() -> None:
    season = made("attempts_per_day = 1")

    def remaining() -> int:
        return left(season.state, season.state.entrants["ann"], season.now)

    ask(season, "ann")
    season.act(journal.START, "ann", number=1)
    season.act(journal.OURS, "ann", "the disk was full", number=1)
    assert remaining() == 1
    season.attempt("ann", 1.0)
    assert remaining() == 0
    season.attempt("ann", 2.0, instead=2)  # a rerun
    assert remaining() == 0
    season.act(journal.GRANT, "ann", "the network was down", number=2)
    assert remaining() == 2
    ask(season, "ann")
    assert remaining() == 1
    season.act(journal.CANCEL, "ann", "it left", number=4)
    assert remaining() == 2
    season.now += timedelta(days=1)
    assert remaining() == 3


@pytest.mark.parametrize(
    ("wrong", "why"),
    [
        (act(journal.START, "ann", "", number=2), "has no attempt 2"),
        (act(journal.REQUEST, "ann", "", number=3), "queues attempt 3 of ann, who has 1"),
        (act(journal.OVER, "ann", "", number=1), "over of attempt 1 of ann, which was waiting"),
        (act(journal.PAUSE, "dora", ""), "there is no entrant dora"),
        (act("praise", "ann", ""), "act 'praise', which there is not"),
        (act(journal.ENROL, "../dora", ""), "admits '../dora', which cannot be a name"),
        (act(journal.ADD, "dora", "", alias="../../owl"), "admits 'dora', which cannot be a name"),
        (act(journal.ADD, "dora", "", alias="owl\0"), "admits 'dora', which cannot be a name"),
        (journal.Act("noon", journal.CLOSE, EVERYBODY, ""), "at 'noon', which is not a time"),
        (act(journal.CHANGE, "secret", "", value="1"), "cannot have secret = 1"),
        (act(journal.CHANGE, "parallel", "", value="0"), "cannot have parallel = 0"),
    ],
)
def test_a_journal_that_cannot_be_is_refused(wrong: journal.Act, why: str) -> None:
    season = made()
    ask(season, "ann")
    state = season.state
    with pytest.raises(ExperimentError, match=why):
        state.apply(wrong)
