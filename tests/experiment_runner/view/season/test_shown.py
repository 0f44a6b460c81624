"""What the page shows of a board: one view for each viewer, as JSON and as a feed."""

from __future__ import annotations

import json
import math
import re
from dataclasses import replace
from typing import Any
from xml.etree import ElementTree

import pytest

from experiment_runner.competition.records import journal
from experiment_runner.competition.season.board import ORGANISER, PUBLIC, SeasonBoard
from experiment_runner.competition.settings import Competition, Task
from experiment_runner.view.season.feed import feed_of
from experiment_runner.view.season.shown import board_as_json, entrant_as_json, rules_of
from experiment_runner.view.stream import as_json
from tests.experiment_runner.competition.season.made import FILE, Made

MADE = Made(["otter", "mole", "weasel"], FILE.replace('enrol = "open"', 'enrol = "open"\nnames = "own"'))
MADE.attempt("otter", 10.0, 11.0)
MADE.act(journal.ANNOUNCE, reason="A & B")
MADE.act(journal.EXCLUDE, "weasel", "posed as another")
MADE.attempt("otter", 1.0, forfeit="the bank")
MADE.act(journal.REQUEST, "otter", number=3)
MADE.act(journal.START, "otter", number=3)
MADE.act(journal.REQUEST, "mole", number=1)
BOARD = MADE.board()


def shown(board: SeasonBoard, viewer: str = PUBLIC) -> dict[str, Any]:
    """Return the board as the page's script reads it."""
    found: dict[str, Any] = json.loads(as_json(board_as_json(board, MADE.state, [], viewer, MADE.now)))
    return found


def test_a_board_is_shown_in_its_own_order_with_nothing_that_json_cannot_express() -> None:
    found = shown(replace(BOARD, competition="<b>spring\x07</b>"))
    assert found["season"] == "<b>spring?</b>"
    first, last, _ = found["entrants"]
    assert (first["name"], first["place"], first["score"], first["counting"]) == ("otter", 1, 10.5, [1])
    assert (last["name"], last["place"], last["score"]) == ("mole", None, None)
    assert last["why"] == "no verified attempt yet"
    assert found["playing"] == [{"name": "otter", "attempt": 3, "since": "2026-12-01T09:13:00Z"}]
    assert found["waiting"] == ["mole"]
    assert found["you"] is None


@pytest.mark.parametrize(
    ("change", "viewer", "words"),
    [
        ({}, PUBLIC, "open until 2026-12-20 00:00 UTC"),
        ({"phase": "before"}, PUBLIC, "opens at 2026-12-01 00:00 UTC"),
        ({"frozen": BOARD.times[0]}, PUBLIC, "as it was at 2026-12-01 09:06 UTC: the board is frozen"),
        ({"frozen": BOARD.times[0]}, ORGANISER, "frozen for others since 2026-12-01 09:06 UTC"),
        ({"paused": "a power cut"}, PUBLIC, "paused: a power cut"),
        ({"phase": "closed"}, PUBLIC, "closed"),
    ],
)
def test_the_state_of_the_season_is_said_in_words(change: dict[str, str], viewer: str, words: str) -> None:
    assert words in str(shown(replace(BOARD, **change), viewer)["state"])  # type: ignore[arg-type]


def test_an_entrant_is_shown_with_its_attempts_newest_first_and_what_ended_them() -> None:
    found = entrant_as_json(BOARD, "otter")
    assert [one["attempt"] for one in found["attempts"]] == [3, 2, 1]
    assert [one["why"] for one in found["attempts"]] == ["", "walk, trial 1: the bank", ""]
    assert [one["replay"] for one in found["attempts"]] == [False, False, True]
    (waits,) = entrant_as_json(BOARD, "mole")["attempts"]
    assert (waits["why"], waits["score"]) == ("number 1 in the queue", None)
    with pytest.raises(KeyError):
        entrant_as_json(BOARD, "vole")


def test_without_a_task_that_may_be_seen_nothing_can_be_replayed() -> None:
    hidden = replace(BOARD, tasks=(), hidden=("walk",))
    assert not any(one["replay"] for one in entrant_as_json(hidden, "otter")["attempts"])


def test_the_first_place_is_on_top_of_the_drawing_and_has_no_sign() -> None:
    drawn = entrant_as_json(BOARD, "otter")["over_time"]
    for size in ("narrow", "wide"):
        assert not re.search(r">-\d", drawn[size])
    assert entrant_as_json(BOARD, "mole")["over_time"] is None


@pytest.mark.parametrize(
    ("time", "unit"), [("01T09:12", "minutes"), ("01T18:00", "hours"), ("04T09:00", "days")]
)
def test_the_drawing_has_a_unit_that_fits(time: str, unit: str) -> None:
    played = replace(BOARD, times=(*BOARD.times[:-1], f"2026-12-{time}:00Z"))
    assert f">{unit}<" in entrant_as_json(played, "otter")["over_time"]["wide"]


def test_rules_say_what_may_be_asked_for_and_how_limits_answer() -> None:
    task = Task("walk", "skeleton", episodes=1, phase="proving", hidden=True)
    text = " ".join(rules_of(Competition(tasks=(task,)), replace(MADE.state.season, images=True)))
    for words in ("5 a day (UTC)", "429 or 503", "GiB for an image", "hidden levels", "best attempt"):
        assert words in text


def test_the_feed_is_newest_first_well_formed_and_the_same_for_the_same_board() -> None:
    feed = ElementTree.fromstring(feed_of(replace(BOARD, competition="<b>spring\x07</b>")))
    names = {"a": "http://www.w3.org/2005/Atom"}
    entries = feed.findall("a:entry", names)
    assert [one.findtext("a:title", namespaces=names) for one in entries] == [
        "otter: attempt 2 forfeited",
        "excluded: weasel, 2026-12-01T09:08:00Z: posed as another",
        "A & B",
        "otter: attempt 1 verified, score 10.50",
    ]
    ids = [one.findtext("a:id", namespaces=names) for one in entries]
    assert len(set(ids)) == 4
    assert feed.findtext("a:updated", namespaces=names) == BOARD.times[-1]
    assert feed.findtext("a:title", namespaces=names) == "<b>spring?</b>"
    assert feed_of(BOARD) == feed_of(BOARD)
    secret = replace(BOARD, tasks=(), entrants=(replace(BOARD.entrants[0], score=math.nan),))
    assert b"score" not in feed_of(secret)


def test_the_feed_of_a_season_where_nothing_has_happened_is_one() -> None:
    empty = replace(BOARD, entrants=(), announcements=(), acts=())
    assert b"<entry" not in feed_of(empty)
    assert journal.ANNOUNCE not in feed_of(empty).decode()
