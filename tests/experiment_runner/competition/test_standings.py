"""Standings of a competition in progress: entrants without a place yet, and the reasons."""

from __future__ import annotations

import csv
import io
from pathlib import Path

import pytest

from experiment_runner.competition.board.forms import as_csv, as_text
from experiment_runner.competition.board.standings import Standing, standings
from experiment_runner.competition.course import course_of
from experiment_runner.competition.organiser import open_competition
from experiment_runner.competition.records import seal
from experiment_runner.competition.records.record import digest, record_path
from experiment_runner.competition.settings import parse_competition
from experiment_runner.store.layout import ABOUT_FILE
from experiment_runner.store.records import EpisodeResult, ReplayVerdict, TrialEnd
from glue.errors import ExperimentError

FILE = """
seed_env = "S"
tasks.walk = { env = "skeleton", episodes = 2 }
entrants.late = { command = ["true"] }
entrants.unverified = { command = ["true"] }
entrants.forger = { command = ["true"] }
"""


def test_who_has_no_place_is_last_with_the_reason(tmp_path: Path) -> None:
    competition = parse_competition(FILE, tmp_path / "spring.toml")
    with open_competition(tmp_path / "run", FILE, competition, b"secret") as store:
        for name in ("unverified", "forger"):
            seal.record_outcome(store, f"{name}/walk/0", TrialEnd("it left", b"digest"))
        seal.record_verdict(store, "forger/walk/0", ReplayVerdict(b"digest", "a reward differs", 0.0))

        course = course_of(tmp_path / "run")
        found: dict[str, Standing] = {one.name: one for one in standings(store, course).entrants}
        assert {one.place for one in found.values()} == {None}
        assert "not played to the end yet" in found["late"].missing
        assert "not verified yet" in found["unverified"].missing
        assert "a reward differs" in found["forger"].missing
        assert found["forger"].forfeits[0].reason == "it left"
        assert not standings(store, course).seeds
        assert [seed.task for seed in standings(store, course, reveal=True).seeds] == ["walk"]

        (tmp_path / "run" / ABOUT_FILE).write_text("{}")
        with pytest.raises(ExperimentError, match=r"run\.json"):
            standings(store, course)


TIMED = """
seed_env = "S"
tasks.walk = { env = "skeleton", episodes = 2, rate = 24 }
entrants.quick = { command = ["true"] }
entrants.slow = { command = ["true"] }
"""


def test_the_board_shows_the_share_of_late_actions_of_a_task_with_a_rate(tmp_path: Path) -> None:
    folder = tmp_path / "run"
    competition = parse_competition(TIMED, tmp_path / "spring.toml")
    with open_competition(folder, TIMED, competition, b"secret") as store:
        for name, late in (("quick", 0), ("slow", 5)):
            trial = f"{name}/walk/0"
            record = record_path(folder, trial)
            record.parent.mkdir(parents=True, exist_ok=True)
            record.write_bytes(b"a record")
            for number in (1, 2):
                store.record(trial, EpisodeResult(number, 1.0, 20, True, 0.5, late))
            seal.record_outcome(store, trial, TrialEnd(None, digest(record)))
            seal.record_verdict(store, trial, ReplayVerdict(digest(record), None, 2.0))
        board = standings(store, course_of(folder))
    assert {one.name: one.late for one in board.entrants} == {"quick": 0.0, "slow": 0.25}
    assert "25.0%" in as_text(board)
    header, *rows = csv.reader(io.StringIO(as_csv(board)))
    assert [row[header.index("late")] for row in rows] == ["0.0", "0.25"]
