"""What the page shows of a board: one view for each viewer, as JSON and as a feed."""

from __future__ import annotations

import json
import math
import re
from dataclasses import replace
from datetime import UTC, datetime
from typing import Any
from xml.etree import ElementTree

import pytest

from experiment_runner.competition.board.standings import Forfeit
from experiment_runner.competition.records.journal import ANNOUNCE, EXCLUDE, Act
from experiment_runner.competition.season.board import ORGANISER, PUBLIC, AttemptRow, EntrantRow, SeasonBoard
from experiment_runner.competition.settings import Competition, Season, Task
from experiment_runner.competition.state import State
from experiment_runner.view.season.feed import feed_of
from experiment_runner.view.season.shown import board_as_json, entrant_as_json, rules_of
from experiment_runner.view.stream import as_json

SEASON = Season(datetime(2026, 11, 1, tzinfo=UTC), datetime(2026, 12, 1, tzinfo=UTC))
NOW = datetime(2026, 11, 3, 12, tzinfo=UTC)
TIMES = ("2026-11-01T09:00:00Z", "2026-11-02T09:00:00Z", "2026-11-03T09:00:00Z")

FIRST = EntrantRow(
    "otter",
    place=1,
    score=10.5,
    low=9.0,
    high=12.0,
    tasks={"walk": 10.5},
    counts={"verified": 1, "forfeited": 1},
    attempts=(
        AttemptRow(1, "verified", TIMES[0], TIMES[0], TIMES[1], 10.5, {"walk": 10.5}, counts=True),
        AttemptRow(
            2, "forfeited", TIMES[1], TIMES[1], TIMES[2], 1.0, forfeits=(Forfeit("walk", 0, "the bank"),)
        ),
    ),
    places=(None, 1, 1),
)
LAST = EntrantRow(
    "mole",
    attempts=(AttemptRow(1, "waiting", TIMES[2], place=3),),
    missing="no attempt is verified",
    places=(None,) * 3,
)
BOARD = SeasonBoard(
    competition="<b>spring\x07</b>",
    phase="open",
    opens=TIMES[0],
    closes="2026-12-01T00:00:00Z",
    frozen="",
    paused="",
    count="best",
    tasks=("walk",),
    hidden=(),
    entrants=(FIRST, LAST),
    times=TIMES,
    playing=(("otter", 2),),
    waiting=(("mole", 1),),
    announcements=(("2026-11-02T10:00:00Z", "A & B"),),
    acts=(Act("2026-11-02T11:00:00Z", EXCLUDE, "weasel", "posed as another"),),
)


def shown(board: SeasonBoard, viewer: str = PUBLIC) -> dict[str, Any]:
    """Return the board as the page's script reads it."""
    found: dict[str, Any] = json.loads(as_json(board_as_json(board, State(SEASON), [], viewer, NOW)))
    return found


def test_a_board_is_shown_in_its_own_order_with_nothing_that_json_cannot_express() -> None:
    found = shown(BOARD)
    assert found["season"] == "<b>spring?</b>"
    first, last = found["entrants"]
    assert (first["name"], first["place"], first["score"], first["counting"]) == ("otter", 1, 10.5, [1])
    assert (last["name"], last["place"], last["score"]) == ("mole", None, None)
    assert last["why"] == "no attempt is verified"
    assert found["playing"] == [{"name": "otter", "attempt": 2, "since": TIMES[1]}]
    assert found["waiting"] == ["mole"]
    assert found["you"] is None


@pytest.mark.parametrize(
    ("change", "viewer", "words"),
    [
        ({}, PUBLIC, "open until 2026-12-01 00:00 UTC"),
        ({"phase": "before"}, PUBLIC, "opens at 2026-11-01 09:00 UTC"),
        ({"frozen": TIMES[1]}, PUBLIC, "as it was at 2026-11-02 09:00 UTC: the board is frozen"),
        ({"frozen": TIMES[1]}, ORGANISER, "frozen for others since 2026-11-02 09:00 UTC"),
        ({"paused": "a power cut"}, PUBLIC, "paused: a power cut"),
        ({"phase": "closed"}, PUBLIC, "closed"),
    ],
)
def test_the_state_of_the_season_is_said_in_words(change: dict[str, str], viewer: str, words: str) -> None:
    assert words in str(shown(replace(BOARD, **change), viewer)["state"])  # type: ignore[arg-type]


def test_an_entrant_is_shown_with_its_attempts_newest_first_and_what_ended_them() -> None:
    found = entrant_as_json(BOARD, "otter")
    assert [one["attempt"] for one in found["attempts"]] == [2, 1]
    assert [one["why"] for one in found["attempts"]] == ["walk, trial 0: the bank", ""]
    assert [one["replay"] for one in found["attempts"]] == [False, True]
    (waits,) = entrant_as_json(BOARD, "mole")["attempts"]
    assert (waits["why"], waits["score"]) == ("number 3 in the queue", None)
    with pytest.raises(KeyError):
        entrant_as_json(BOARD, "weasel")


def test_without_a_task_that_may_be_seen_nothing_can_be_replayed() -> None:
    hidden = replace(BOARD, tasks=(), hidden=("walk",))
    assert not any(one["replay"] for one in entrant_as_json(hidden, "otter")["attempts"])


def test_the_first_place_is_on_top_of_the_drawing_and_has_no_sign() -> None:
    drawn = entrant_as_json(BOARD, "otter")["over_time"]
    for size in ("narrow", "wide"):
        assert not re.search(r">-\d", drawn[size])
        assert ">days<" in drawn[size]
    assert entrant_as_json(BOARD, "mole")["over_time"] is None


@pytest.mark.parametrize(("span", "unit"), [("00:02:00", "minutes"), ("09:00:00", "hours")])
def test_the_drawing_of_a_young_season_has_a_unit_that_fits(span: str, unit: str) -> None:
    young = replace(BOARD, times=("2026-11-01T00:00:00Z", "2026-11-01T00:01:00Z", f"2026-11-01T{span}Z"))
    assert f">{unit}<" in entrant_as_json(young, "otter")["over_time"]["wide"]


def test_rules_say_what_may_be_asked_for_and_how_limits_answer() -> None:
    task = Task("walk", "skeleton", episodes=1, phase="proving", hidden=True)
    text = " ".join(rules_of(Competition(tasks=(task,)), replace(SEASON, images=True)))
    for words in ("5 a day (UTC)", "429 or 503", "GiB for an image", "hidden levels", "best attempt"):
        assert words in text


def test_the_feed_is_newest_first_well_formed_and_the_same_for_the_same_board() -> None:
    feed = ElementTree.fromstring(feed_of(BOARD))
    names = {"a": "http://www.w3.org/2005/Atom"}
    entries = feed.findall("a:entry", names)
    assert [one.findtext("a:title", namespaces=names) for one in entries] == [
        "otter: attempt 2 forfeited",
        "excluded: weasel, 2026-11-02T11:00:00Z: posed as another",
        "A & B",
        "otter: attempt 1 verified, score 10.50",
    ]
    ids = [one.findtext("a:id", namespaces=names) for one in entries]
    assert len(set(ids)) == 4
    assert feed.findtext("a:updated", namespaces=names) == TIMES[2]
    assert feed.findtext("a:title", namespaces=names) == "<b>spring?</b>"
    assert feed_of(BOARD) == feed_of(BOARD)
    secret = replace(BOARD, tasks=(), entrants=(replace(FIRST, score=math.nan),))
    assert b"score" not in feed_of(secret)


def test_the_feed_of_a_season_where_nothing_has_happened_is_one() -> None:
    empty = replace(BOARD, entrants=(), announcements=(), acts=())
    assert b"<entry" not in feed_of(empty)
    assert ANNOUNCE not in feed_of(empty).decode()
