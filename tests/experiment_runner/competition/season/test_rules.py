"""The table [season] and the phases of tasks in a competition's file."""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from zoneinfo import ZoneInfo

import pytest

from experiment_runner.competition.course import Course
from experiment_runner.competition.records import journal
from experiment_runner.competition.settings import changed, changes, parse_competition
from experiment_runner.competition.trials import attempt_trials, levels, trials
from glue.errors import ConfigError, ExperimentError
from tests.experiment_runner.competition.season.made import FILE, SECRET, Made

_FILE = """\
seed_env = "SECRET"
[season]
opens = 2026-12-01T09:00:00
closes = 2026-12-20T18:00:00Z
zone = "Europe/Berlin"
code_file = "code.txt"
most_bytes = "512m"
[tasks]
easy = { env = "mines", steps = 20, phase = "proving" }
final = { env = "mines", steps = 20 }
"""


def test_a_season_is_read() -> None:
    found = parse_competition(_FILE, Path("folder/spring.toml"))
    season = found.season
    assert season is not None
    assert season.opens == datetime(2026, 12, 1, 9, tzinfo=ZoneInfo("Europe/Berlin"))
    assert season.closes == datetime(2026, 12, 20, 18, tzinfo=UTC)
    assert (season.code_file, season.most_bytes) == (Path("folder/code.txt"), 512 * 2**20)
    assert ([one.name for one in found.proving], [one.name for one in found.testing]) == (["easy"], ["final"])
    assert found.entrants == ()


@pytest.mark.parametrize(
    ("old", "new", "line", "why"),
    [
        ("opens = 2026-12-01T09:00:00\n", "", 2, "needs opens"),
        ("T09:00:00\n", "\n", 3, "opens must be a time, as in 2026-12-01T09:00:00"),
        ("2026-12-20", "2026-11-20", 4, "a season opens first"),
        ("18:00:00Z", "18:00:00Z\nfreeze = 2026-12-24T18:00:00", 4, "a season opens first"),
        ("Europe/Berlin", "Europe/Atlantis", 5, "the name of a time zone"),
        ("Europe/Berlin", "../../etc/passwd", 5, "the name of a time zone"),
        ('code_file = "code.txt"\n', "", 2, "name the code"),
        ('code_file = "code.txt"', 'code_file = "c"\ncode_env = "C"', 2, "name the code"),
        ('"512m"', '"lots"', 7, "most_bytes is a number of bytes"),
        (', phase = "proving"', "", 8, "a season needs a task"),
        ('"proving"', '"proving", hidden = true', 8, "a season needs a task"),
        ("final = { ", "final = { hidden = true, ", 10, "scores are hidden anyway"),
    ],
)
def test_a_mistake_has_its_line(old: str, new: str, line: int, why: str) -> None:
    with pytest.raises(ConfigError, match=why) as failure:
        parse_competition(_FILE.replace(old, new), Path("spring.toml"))
    assert f"line {line}:" in str(failure.value)


def test_changes_of_the_rules_are_acts_and_others_are_refused_by_name() -> None:
    made = Made(["ann"])
    now = parse_competition(
        FILE.replace('enrol = "open"', 'enrol = "closed"\nfreeze = 2026-12-10T00:00:00Z'), Path("spring.toml")
    )
    acts = made.course.changes(now)
    assert [one.subject for one in acts] == ["freeze", "enrol"]
    course = Course(made.competition, [*made.acts, *acts])
    assert course.state.season == now.season
    assert course.changes(now) == []
    assert made.competition.season is not None
    assert changed(made.competition.season, "freeze", "null") == made.competition.season
    assert changes(made.competition.season, made.competition.season) == {}
    for old, new, what in (
        ("trials = 2", "trials = 3", "trials"),
        ("unseen =", "other =", "tasks"),
        (", hidden = true", "", "phases"),
        ("episodes = 1", "episodes = 2", "episodes or steps"),
        ("[season]", "[limits]\ncpus = 2\n[season]", "limits"),
        ('final = { env = "skeleton"', 'final = { env = "walk.py:Walk"', "env"),
        ("final = {", "final = { options = { size = 7 },", "options"),
        ("final = {", 'final = { levels = ["a.txt"],', "levels"),
        ("final = {", "final = { max_steps = 9,", "max_steps"),
    ):
        other = parse_competition(FILE.replace(old, new), Path("spring.toml"))
        with pytest.raises(ExperimentError, match=f"begun with other {what}: put back"):
            course.admitted(other)


def test_pauses_of_a_season_end_with_it_and_exclusions_do_not() -> None:
    made = Made(["ann", "ben", "cid"])
    for name in ("ann", "ben"):
        made.act(journal.PAUSE, name, "its image")
        made.act(journal.EXCLUDE, name, "the rules")
    made.act(journal.RESUME, "ben")
    made.act(journal.READMIT, "ben")
    assert made.course.paused == {"ann": "its image"}
    made.act(journal.CLOSE)
    made.act(journal.PAUSE, "cid", "its key")
    assert made.course.paused == {"cid": "its key"}
    assert made.course.excluded == {"ann": "the rules"}


def test_an_attempt_has_the_levels_of_a_run_on_the_same_tasks() -> None:
    """So that an honest entrant has the same scores, to the byte."""
    made = Made(["ann"])
    for _ in range(2):
        made.attempt("ann", 1.0)
    alone = parse_competition(
        FILE.partition("[season]")[0]
        + FILE.partition('enrol = "open"\n')[2]
        .replace(', phase = "proving"', "")
        .replace(", hidden = true", "")
        + '[entrants.ann]\ncommand = ["true"]\n',
        Path("spring.toml"),
    )
    run = {spec.id.parts[1:]: spec for spec in trials(alone, SECRET)}
    season = made.course.specs(made.course.admitted(made.competition), SECRET)
    assert [spec.id for spec in season] == [
        f"ann/{task}/{number}"
        for first in (0, 2)
        for task in ("walk", "unseen")
        for number in (first, first + 1)
    ]
    for spec in season:
        same = run[spec.id.parts[1], spec.id.number % 2]
        assert replace(spec, id=same.id, agent=same.agent) == same
    start = next(one for one in made.acts if one.act == journal.START and one.number == 2)
    assert attempt_trials(levels(made.competition, SECRET), 2, start) == season[4:]


def test_entrants_play_the_testing_tasks_with_what_they_had_last() -> None:
    made = Made(["ann", "bob"])
    image = "sha256:" + 64 * "0"
    made.act(journal.IMAGE, "bob", "submitted", player="bob:2", id=image)
    made.attempt("ann", 1.0)
    assert made.course.trials == []
    made.act(journal.CLOSE)
    assert made.course.trials == [f"{name}/final/{number}" for number in (0, 1) for name in ("ann", "bob")]
    ann, bob = made.course.admitted(made.competition).entrants
    assert (ann.key, ann.image, ann.id) == (Path("ann.pub"), None, "key of ann")
    assert (bob.key, bob.image, bob.id) == (None, "bob:2", image)
