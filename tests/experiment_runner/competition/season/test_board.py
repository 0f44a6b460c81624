"""The board of a season: what counts, who sees what, and what a rerun changes."""

from __future__ import annotations

import gc
import math
import weakref
from contextlib import suppress
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from experiment_runner.competition.records import journal
from experiment_runner.competition.records.journal import Act
from experiment_runner.competition.season.board import ORGANISER, PUBLIC, Boards, EntrantRow, SeasonBoard
from experiment_runner.competition.season.forms import as_text
from experiment_runner.store.records import ReplayVerdict
from glue.errors import ExperimentError
from tests.experiment_runner.competition.season.made import FILE, Made

NAMES = ("ann", "bob", "cy")
OWN = FILE.replace('enrol = "open"', 'enrol = "open"\nnames = "own"')


@pytest.fixture
def made() -> Made:
    return Made(NAMES, OWN)


def test_places_follow_the_unrounded_score_and_equal_scores_share_one(made: Made) -> None:
    made.attempt("ann", 1.0)
    made.attempt("bob", 1.0)
    assert [row.place for row in made.board().entrants] == [1, 1, None]
    made.attempt("cy", math.nextafter(1.0, 2))
    assert [(row.shown, row.place) for row in made.board().entrants] == [("cy", 1), ("ann", 2), ("bob", 2)]
    made.attempt("ann", 0.5, 2.0)
    assert [(row.shown, row.place) for row in made.board().entrants] == [("ann", 1), ("cy", 2), ("bob", 3)]
    assert made.rows()["bob"].places == (None, 1, 2, 3)
    assert (made.rows()["ann"].low, made.rows()["ann"].high) == (0.5, 2.0)


@pytest.mark.parametrize(
    ("count", "score", "counting"), [("best", 5.0, [2]), ("last", 2.0, [3]), ("mean", 3.0, [1, 2, 3])]
)
def test_the_file_says_which_attempts_count(count: str, score: float, counting: list[int]) -> None:
    made = Made(["ann"], OWN.replace("[season]", f'[season]\ncount = "{count}"'))
    for one in (2.0, 5.0, 2.0):
        made.attempt("ann", one)
    made.act(journal.REQUEST, "ann", number=4)
    row = made.rows()["ann"]
    assert row.score == row.tasks["walk"] == score
    assert [one.number for one in row.attempts if one.counts] == counting
    assert row.attempts[3].place == 1
    assert made.board().waiting == (("ann", 4),)


def test_the_share_of_late_actions_is_that_of_the_attempts_that_count(made: Made) -> None:
    assert "late" not in as_text(made.board())
    trials = made.competition.trials
    for name, score, late in (("ann", 1.0, 30), ("ann", 2.0, 5), ("bob", 3.0, 0), ("cy", 1.0, None)):
        number = made.attempt(name, score)
        if late is not None:  # in each trial of the task with a rate
            made.late |= {f"{name}/walk/{(number - 1) * trials + i}": (late, 50) for i in range(trials)}
    rows = made.rows()
    assert (rows["ann"].late, rows["bob"].late, math.isnan(rows["cy"].late)) == (0.1, 0.0, True)
    text = as_text(made.board())
    assert ("10.0%" in text, " 0.0%" in text, "nan" in text) == (True, True, False)


def test_what_was_withdrawn_excluded_ours_or_not_verified_does_not_count(made: Made) -> None:
    made.attempt("ann", 1.0)
    made.attempt("ann", 9.0)
    made.act(journal.WITHDRAW, "ann", number=2)
    made.attempt("ann", 8.0, instead=2)
    assert made.rows()["ann"].score == 1.0
    made.act(journal.REQUEST, "ann", number=4)
    made.act(journal.START, "ann", number=4)
    made.act(journal.OURS, "ann", "the disk was full", number=4)
    assert made.rows()["ann"].counts == {"verified": 3, "ours": 1}
    assert made.rows()["ann"].attempts[3].why == ""
    assert made.rows("ann")["ann"].attempts[3].why == "the disk was full"
    made.attempt("bob", 3.0)
    made.act(journal.EXCLUDE, "bob", "it read mail")
    assert made.rows()["bob"].missing == "excluded: it read mail"
    assert made.rows()["ann"].place == 1
    made.act(journal.READMIT, "bob", "it did not")
    assert made.rows()["bob"].place == 1
    made.verdicts["bob/walk/0"] = ReplayVerdict(b"digest", "a reward differs", math.nan)
    assert made.rows()["bob"].missing == "no verified attempt yet"
    assert made.rows()["bob"].counts == {"unverified": 1}


def test_a_forfeit_never_beats_a_game_that_was_played_to_its_end(made: Made) -> None:
    made.attempt("ann", -8.0)
    made.attempt("bob", 0.0, forfeit="no answer for 5 s")
    rows = made.rows()
    assert rows["bob"].score == (0.0 - 8.0) / 2
    assert rows["bob"].counts == {"forfeited": 1}
    assert [(lost.task, lost.trial, lost.reason) for lost in rows["bob"].attempts[0].forfeits] == [
        ("walk", 1, "no answer for 5 s")
    ]


def test_hidden_tasks_are_told_when_the_season_is_closed(made: Made) -> None:
    made.attempt("ann", 1.0, unseen=7.0)
    for viewer in ("", "ann"):
        assert made.board(viewer).tasks == ("walk",)
        assert made.rows(viewer)["ann"].score == 1.0
        assert "7.0" not in repr(made.board(viewer))
    assert made.rows(ORGANISER)["ann"].score == 8.0
    made.act(journal.CLOSE)
    assert (made.board().phase, made.board().tasks) == ("closed", ("walk", "unseen"))
    assert made.rows()["ann"].score == 8.0


def test_a_frozen_board_changes_for_the_organiser_alone(made: Made) -> None:
    made.attempt("ann", 1.0)
    made.act(journal.FREEZE)
    made.attempt("bob", 2.0)
    made.act(journal.WITHDRAW, "ann", number=1)
    assert [(row.shown, row.place) for row in made.board().entrants][:2] == [("ann", 1), ("bob", None)]
    assert [made.rows(who)["ann"].attempts[0].withdrawn for who in ("", "bob", "ann")] == [False, False, True]
    assert made.rows()["bob"].counts == {"over": 1}
    assert made.board().frozen
    assert made.rows("bob")["bob"].attempts[0].score == 2.0
    assert made.rows("bob")["bob"].place is None
    assert made.rows(ORGANISER)["bob"].place == 1
    made.act(journal.THAW)
    assert made.rows()["bob"].place == 1
    made.act(journal.FREEZE)
    made.act(journal.CLOSE)
    assert not made.board().frozen


def test_a_planned_freeze_begins_whatever_was_thawed_before() -> None:
    made = Made(["ann"], FILE.replace("[season]", "[season]\nfreeze = 2026-12-10T00:00:00Z"))
    for day, kinds, frozen in (
        (2, (), ""),
        (3, (journal.FREEZE, journal.THAW), ""),
        (11, (), "2026-12-10T00:00:00Z"),
        (12, (journal.THAW,), ""),
        (13, (journal.FREEZE,), "2026-12-13T09:01:00Z"),
    ):
        made.now = made.now.replace(day=day, minute=0)
        for kind in kinds:
            made.act(kind)
        assert made.board().frozen == frozen


def test_pseudonyms_and_reasons_are_for_the_owner_and_the_organiser() -> None:
    made = Made(NAMES)
    made.attempt("ann", 1.0)
    made.act(journal.PAUSE, "ann", "three forfeits")
    made.act(journal.EXCLUDE, "bob", "it read mail")
    public = repr(made.board())
    assert not any(f"'{name}" in public for name in NAMES)
    assert "three forfeits" not in public
    assert "key of" not in repr(made.board(ORGANISER))
    own = made.rows("ann")
    assert (own["ann"].mine, own["ann"].paused) == (True, "three forfeits")
    assert set(own) == {"ann", "alias of bob", "alias of cy"}
    assert set(made.rows(ORGANISER)) == set(NAMES)


def test_one_viewer_does_not_see_what_was_made_for_another() -> None:
    made = Made(NAMES)
    made.attempt("ann", 1.0)
    made.act(journal.PAUSE, "ann", "three forfeits")
    boards = Boards(made.course, made.outcomes, made.verdicts, made.late, made.now)
    for viewer in ("ann", PUBLIC, ORGANISER, "ann", "bob", PUBLIC):
        assert boards.seen_by(viewer) == made.board(viewer)


def test_who_is_not_separated_is_said() -> None:
    made = Made(("ann", "bob", "cy"), OWN.replace("trials = 2", "trials = 10"))
    made.attempt("ann", *(10.0 + i for i in range(10)))
    made.attempt("bob", *(10.0 + i - (1.5 if i % 2 else -1.0) for i in range(10)))
    made.attempt("cy", *(5.0 + i for i in range(10)))
    assert [(row.shown, row.like) for row in made.board().entrants] == [
        ("ann", None),
        ("bob", 1),
        ("cy", None),
    ]


_KINDS = st.sampled_from(
    [
        *(journal.ENROL, journal.REQUEST, journal.START, journal.OVER, journal.OURS, journal.CANCEL),
        *(journal.WITHDRAW, journal.RERUN, journal.GRANT, journal.IMAGE, journal.EXCLUDE, journal.READMIT),
        *(journal.FREEZE, journal.THAW, journal.CLOSE, journal.ADD, "praise"),
    ]
)
_SUBJECTS = st.sampled_from([*NAMES, journal.EVERYBODY, "ann/walk/0", ""])
_WHEN = st.sampled_from(["2026-12-01T09:00:00Z", "2026-12-02T09:00:00Z", "0001-01-01T00:00:00Z", "noon"])
_NUMBERS = st.integers(-1, 4)


_ACTS = st.builds(Act, _WHEN, _KINDS, _SUBJECTS, st.just("a mail"), number=_NUMBERS, instead=_NUMBERS)


@given(st.lists(_ACTS, max_size=60))
def test_an_act_of_strangers_is_refused_or_there_is_a_board_after_it(acts: list[Act]) -> None:
    made = Made(NAMES)
    state = made.state
    for one in acts:
        with suppress(ExperimentError):
            state.apply(one)
            made.acts.append(one)
    for viewer in (PUBLIC, ORGANISER, "ann"):
        for row in made.board(viewer).entrants:
            assert sum(row.counts.values()) == len(row.attempts)


def essence(board: SeasonBoard) -> list[EntrantRow]:
    """Return the rows without their attempts, and the number in each state."""
    return [replace(row, attempts=(), counts={}) for row in board.entrants]


_SCORES = st.lists(st.integers(-5, 5).map(float), min_size=2, max_size=2)
_TRIES = st.lists(st.tuples(_SCORES, st.sampled_from(["", "it left"])), min_size=1, max_size=3)


@given(
    st.lists(st.tuples(st.sampled_from(NAMES), _TRIES), min_size=1, max_size=8),
    st.sampled_from(["best", "last", "mean"]),
)
def test_after_reruns_the_board_is_as_if_it_had_been_so_from_the_start(
    played: list[tuple[str, list[tuple[list[float], str]]]], count: str
) -> None:
    """Each attempt has one try or more, of which each replaces the one before; the reruns come at the end."""
    text = OWN.replace("[season]", f'[season]\ncount = "{count}"')
    again, straight = Made(NAMES, text), Made(NAMES, text)
    numbers = [again.attempt(name, *tries[0][0], forfeit=tries[0][1]) for name, tries in played]
    for number, (name, tries) in zip(numbers, played, strict=True):
        for scores, left in tries[1:]:
            number = again.attempt(name, *scores, forfeit=left, instead=number)
    for name, tries in played:
        scores, left = tries[-1]
        straight.attempt(name, *scores, forfeit=left)
    assert essence(again.board()) == essence(straight.board())


@pytest.mark.parametrize(
    ("reason", "public"),
    [
        ("it did not connect within 8 s", "it did not connect within 8 s"),
        ("its program ended with status 3", "its program ended with status 3"),
        ("its action was refused: no action is called ann", "its action was refused"),
        ("agent AnnsBot raised in agent_step: /home/ann/x is missing", "its agent raised in agent_step"),
        ("the agent AnnsBot was unreachable for 5.0 s", "its agent was unreachable for 5.0 s"),
        ("agent AnnsBot ran out of time: its bank of 60 s is empty", "its agent ran out of time"),
        ("the agent AnnsBot left: I am ann", "its agent left"),
        ("agent AnnsBot has found another way", "its agent failed"),
    ],
)
def test_what_a_program_says_of_its_owner_is_for_its_owner(made: Made, reason: str, public: str) -> None:
    made.attempt("ann", 0.0, forfeit=reason)
    for viewer, told in ((PUBLIC, public), ("bob", public), ("ann", reason), (ORGANISER, reason)):
        rows = made.board(viewer).entrants
        assert [lost.reason for row in rows for one in row.attempts for lost in one.forfeits] == [told]


def test_boards_that_are_old_leave_the_memory_at_once() -> None:
    made = Made(["alice"])
    made.attempt("alice", 1.0)
    boards = Boards(made.course, made.outcomes, made.verdicts, made.late, made.now)
    for viewer in (PUBLIC, ORGANISER, "alice"):
        boards.seen_by(viewer)
    old = weakref.ref(boards)
    gc.disable()
    try:
        del boards
        assert old() is None
    finally:
        gc.enable()
