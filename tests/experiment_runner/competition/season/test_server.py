"""A season's server, turn by turn: who plays, what that costs, and what goes wrong."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from pathlib import Path

import pytest

from experiment_runner.cli.compete_serve import organise
from experiment_runner.competition.organiser import open_competition
from experiment_runner.competition.records.seal import broken
from experiment_runner.competition.season.acts import addition
from experiment_runner.competition.season.control import (
    Attempt,
    Enrol,
    Key,
    Organise,
    Status,
    Submit,
    TryLater,
    Withdraw,
)
from experiment_runner.competition.season.server import gate_of
from experiment_runner.competition.settings import Gate
from experiment_runner.store.layout import DirectoryTaken
from glue.client.libzmq import new_pair
from glue.errors import ConfigError, ExperimentError
from glue.keys.certificates import encode, write_pair
from tests.experiment_runner.competition.players import Walker
from tests.experiment_runner.competition.season.inside import CODE, FILE, SECRET, Absent, Raising, Season

IMAGES = FILE.replace("failures = 2", "failures = 2\nimages = true")
IDS = [f"sha256:{64 * digit}" for digit in "012"]


@pytest.fixture
def season(tmp_path: Path, request: pytest.FixtureRequest) -> Iterator[Season]:
    """A season in which alice has enrolled; of another file if a test has a parameter for it."""
    made = Season(tmp_path, getattr(request, "param", FILE))
    with made.stack:
        made.enrol("alice")
        yield made


def of(file: str) -> pytest.MarkDecorator:
    """Let a test have a season of this file."""
    return pytest.mark.parametrize("season", [file], ids=[""], indirect=True)


def test_an_attempt_is_played_verified_and_over(season: Season) -> None:
    place = {"hub": "tcp://127.0.0.1:4097", "session": "alice"}
    playing = {"state": "playing", "attempt": 1, "trial": 1, "trials": 2}
    assert season.ask(Attempt("alice")) == playing | place
    season.turns()
    assert season.executor.played == ["alice/mines/0", "alice/mines/1"]
    assert season.states("alice") == {1: "over"}
    assert season.store.verdicts().keys() == {"alice/mines/0", "alice/mines/1"}
    assert broken(season.store) == ""
    reply = season.ask(Attempt("alice", 1))
    scores = [verdict.score for verdict in season.store.verdicts().values()]
    assert (reply["state"], reply["outcome"], reply["score"]) == ("over", "verified", sum(scores) / 2)
    assert reply["low"] <= reply["score"] <= reply["high"]
    assert (reply["place"], reply["of"], reply["left"]) == (1, 1, 2)
    assert reply["returns"] == "2026-12-02T00:00:00+00:00"


def test_a_quota_is_used_up_and_returns(season: Season) -> None:
    for _ in range(3):
        season.attempt("alice")
    refused = season.refuses(Attempt("alice"), "has used its 3 attempts of today")
    assert isinstance(refused, TryLater)
    assert refused.retry_after == 15 * 3600
    season.days(1)
    assert season.attempt("alice") == 4


def test_a_waiting_attempt_whose_program_stops_asking_is_cancelled_and_costs_nothing(season: Season) -> None:
    season.act("pause")
    assert season.ask(Attempt("alice")) == {"state": "waiting", "attempt": 1, "place": 1, "why": "because"}
    season.later(70, "alice")
    season.later(20)
    season.enrol("bob")
    season.ask(Attempt("bob"))
    season.act("resume")
    season.turns()
    assert season.states("bob") == {1: "over"}
    assert season.states("alice") == {1: "waiting"}  # and is let play by nobody
    season.later(50)
    assert season.states("alice") == {1: "cancelled"}
    for _ in range(3):
        season.attempt("alice")


def test_as_many_play_as_there_are_slots_each_at_its_port(season: Season) -> None:
    names = ("alice", "bob", "carol")
    season.enrol(*names[1:])
    season.executor.agents = dict.fromkeys(names)
    for name in names:
        season.ask(Attempt(name))
    season.turns()
    assert season.executor.gates == ["tcp://127.0.0.1:4097", "tcp://127.0.0.1:4098"]
    assert season.ask(Attempt("carol"))["state"] == "waiting"
    assert season.ask(Status()) == {"slots": 2, "busy": 2, "accepting": True, "why": ""}


def test_a_failure_of_ours_costs_no_attempt_and_is_tried_again(season: Season) -> None:
    season.enrol("bob")
    season.attempt("alice", "the disk is on fire")
    assert season.states("alice") == {1: "ours", 2: "waiting"}
    assert season.state.attempt("alice", 1).why == "the disk is on fire"
    season.attempt("bob")
    assert season.states("bob") == {1: "over"}
    season.later(5, "alice")
    assert season.states("alice") == {1: "ours", 2: "ours", 3: "waiting"}
    season.later(5, "alice")  # it rests longer each time
    assert season.states("alice")[3] == "waiting"
    del season.executor.agents["alice"]
    season.later(20, "alice")
    assert season.states("alice")[3] == "over"
    assert sum(season.state.entrants["alice"].used.values()) == len(season.states("alice")) - 2


def test_nothing_is_played_without_end_nor_costs_anything_of_the_day_after(season: Season) -> None:
    season.act("grant", "alice", number=1)
    season.attempt("alice", None)
    season.days(1)
    season.seconds += 10_000
    season.turns()
    assert "far too long" in season.state.attempt("alice", 1).why
    del season.executor.agents["alice"]
    season.later(5, "alice")
    for _ in range(4):  # those of today, and the one granted
        season.attempt("alice")
    assert list(season.states("alice").values()) == ["ours", *5 * ["over"]]
    season.refuses(Attempt("alice"), "has used its 3 attempts")


def test_one_that_fails_again_and_again_is_paused_until_the_next_day(season: Season) -> None:
    for agent in (Raising(), Walker(), Raising()):
        season.attempt("alice", agent)
    assert season.state.entrants["alice"].paused == ""
    season.days(1)
    season.attempt("alice")
    paused = season.state.entrants["alice"].paused
    assert paused.startswith("it has forfeited 2 attempts in a row, the last in mines, trial 0: ")
    until = r"; until 2026-12-03 00:00:00\+00:00, or until the organiser resumes it"
    season.refuses(Attempt("alice"), f"alice is paused: it has forfeited .*{until}")
    season.act("resume", "alice")
    for _ in range(2):
        season.attempt("alice")
    assert season.state.entrants["alice"].paused
    season.days(0.7)  # a new day has begun
    season.later(5)
    season.attempt("alice", Walker())
    assert season.state.entrants["alice"].failed == 0


def test_nobody_is_paused_for_the_final_by_an_attempt_that_ends_after_the_season(season: Season) -> None:
    season.attempt("alice", Raising())
    season.executor.agents["alice"] = "the disk is on fire"
    season.ask(Attempt("alice"))
    season.act("close")
    season.turns()
    assert season.states("alice") == {1: "over", 2: "ours", 3: "waiting"}
    assert not season.server.over
    season.executor.agents["alice"] = Raising()
    season.later(20, "alice")
    assert season.states("alice") == {1: "over", 2: "ours", 3: "over"}
    assert season.server.over
    assert season.course.paused == {}


def test_an_exclusion_takes_effect_at_once_and_can_be_taken_back(season: Season) -> None:
    season.attempt("alice", None)
    assert set(season.executor.jobs) == {"alice/mines/0"}
    season.act("exclude", "alice")
    assert not season.executor.jobs
    assert season.states("alice") == {1: "ours"}
    assert season.ask(Key("alice"))["key"]  # so that it is told why
    assert season.ask(Key("nobody")) == {"key": None}
    for refused in (Attempt("alice"), Withdraw("alice", 1), Organise("rerun", "alice", why="because")):
        season.refuses(refused, "alice is excluded: because")
    season.act("readmit", "alice")
    season.attempt("alice", Walker())
    assert season.states("alice") == {1: "ours", 2: "over"}


def test_an_attempt_is_run_again_at_no_cost_when_its_program_is_there(season: Season) -> None:
    for _ in range(3):
        season.attempt("alice")
    season.later(20)
    assert season.act("rerun", "alice", number=2)
    season.later(1000)
    assert season.states("alice")[4] == "waiting"
    season.refuses(Withdraw("alice", 4), "attempt 4 is attempt 2, which the organiser has run again")
    season.seconds += 7 * 86400
    season.turns()
    assert season.states("alice")[4] == "cancelled"
    season.act("rerun", "alice", number=2)
    season.attempt("alice")
    assert season.state.attempt("alice", 5).instead == 2
    assert season.states("alice")[5] == "over"


def test_a_restart_goes_on_where_it_was(season: Season) -> None:
    season.enrol("bob")
    for name in ("alice", "bob"):
        season.attempt(name, None)
    season.act("exclude", "alice")
    season.executor.agents.clear()
    season.restart()
    season.turns()
    assert season.executor.played[2:] == ["bob/mines/0", "bob/mines/1"]
    assert season.executor.gates[1:] == ["tcp://127.0.0.1:4098"] * 3  # where its program looks for it
    assert season.states("bob") == {1: "over"}


def test_what_was_over_before_a_restart_stays_over(season: Season) -> None:
    season.ask(Attempt("alice"))
    while "alice/mines/0" not in season.store.outcomes():
        season.server.turn()
    digest = season.store.outcomes()["alice/mines/0"].digest
    season.restart()
    season.attempt("alice")
    season.later(5)
    assert season.executor.played.count("alice/mines/0") == 1
    assert season.store.outcomes()["alice/mines/0"].digest == digest
    assert season.states("alice") == {1: "over"}


def test_one_that_does_not_come_back_after_a_restart_loses_nothing(season: Season) -> None:
    season.attempt("alice", None)
    season.executor.agents["alice"] = Absent
    season.restart()
    season.turns()
    assert season.states("alice") == {1: "ours", 2: "waiting"}
    season.later(70)
    assert season.states("alice") == {1: "ours", 2: "cancelled"}


def test_who_is_absent_is_waited_for_once(season: Season) -> None:
    season.attempt("alice", Absent)
    assert season.states("alice") == {1: "over"}
    assert season.executor.awaited == ["alice/mines/0"]
    assert season.state.attempt("alice", 1).why == "mines, trial 0: it did not connect within 30 s"
    assert [one.reason for one in season.store.outcomes().values()] == 2 * ["it did not connect within 30 s"]
    assert [one.problem for one in season.store.verdicts().values()] == [None, None]
    season.attempt("alice", Walker())
    assert len(season.executor.awaited) == 1


def test_a_clock_that_is_set_back_and_forward_stops_nothing(season: Season) -> None:
    season.enrol("bob")
    for days in (0, 1, -1, 1, -1):
        season.days(days)
        season.attempt("bob")
    assert set(season.states("bob").values()) == {"over"}
    season.attempt("alice")
    assert season.states("alice") == {1: "over"}
    season.refuses(Attempt("bob"), "has used its 3 attempts")


def test_who_closes_the_season_lets_what_is_played_end(season: Season) -> None:
    season.enrol("bob", "carol")
    season.attempt("carol", None)
    season.act("pause")
    season.ask(Attempt("alice"))
    season.act("close")
    assert season.states("alice") == {1: "cancelled"}
    assert not season.server.over
    season.refuses(Attempt("bob"), "the season closed")
    season.act("exclude", "carol")
    assert season.server.over
    assert not season.server.may_end  # its program asks how it went
    season.seconds += 30
    assert season.server.may_end


def test_programs_that_wait_when_the_season_is_closed_learn_it(season: Season) -> None:
    season.act("pause")
    season.ask(Attempt("alice"))
    season.act("close")
    assert season.server.over
    assert not season.server.may_end


@of(IMAGES)
def test_what_always_fails_does_not_keep_a_closed_season_open(season: Season) -> None:
    season.ask(Submit("alice", IDS[0], "alice:1"))
    season.executor.agents["alice"] = "the disk is on fire"
    season.ask(Attempt("alice"))
    season.act("close")
    for _ in range(10):
        season.later(60)
    assert season.states("alice") == dict.fromkeys((1, 2, 3), "ours")
    assert season.server.over


@pytest.mark.parametrize(
    ("wanted", "why"),
    [
        ({"code": "water"}, "not the code"),
        ({"name": "../bob"}, "cannot be a name"),
        ({"name": "ALICE"}, "the name ALICE is taken"),
        ({"key": "x" * 40}, "the owner of this key takes part already"),
        ({"key": "short"}, "not a public key"),
        ({"team": "red"}, "there are no teams"),
    ],
)
def test_who_cannot_enrol_is_told_why(season: Season, wanted: dict[str, str], why: str) -> None:
    carol = Enrol("carol", "x" * 40, CODE)
    joined = season.ask(carol)
    assert season.ask(carol) == joined  # a reply may have been lost
    other = {"name": "bob", "key": encode(new_pair().public), "code": CODE}
    season.refuses(Enrol(**{**other, **wanted}), why)


def test_one_of_the_file_joins_with_its_key_though_nobody_can_enrol(tmp_path: Path) -> None:
    pair = new_pair()
    write_pair(tmp_path, "zo", pair)
    closed = FILE.replace('enrol = "code"', 'enrol = "closed"\nnames = "own"')
    season = Season(tmp_path, closed + '[entrants.zo]\nkey = "zo.key"\n')
    with season.stack:
        zo = Enrol("zo", encode(pair.public))
        joined = season.ask(zo)
        assert joined["alias"] == "zo"
        assert hashlib.sha256(joined["token"].encode()).hexdigest() == season.state.entrants["zo"].act.token
        season.restart()
        assert season.ask(zo) == joined
        season.attempt("zo")
        assert season.states("zo") == {1: "over"}
        for name in ("zo", "alice"):
            season.refuses(Enrol(name, encode(new_pair().public)), "enrolment is closed")


def test_an_owner_withdraws_what_is_over_or_waits(season: Season) -> None:
    season.attempt("alice")
    season.ask(Withdraw("alice", 1))
    assert season.state.attempt("alice", 1).withdrawn
    season.refuses(Withdraw("alice", 1), "does not count anyway")
    season.act("pause")
    season.ask(Attempt("alice"))
    season.ask(Withdraw("alice", 2))
    assert season.states("alice")[2] == "cancelled"


def test_nobody_hides_an_attempt_where_the_best_does_not_count(season: Season) -> None:
    season.attempt("alice")
    for count, why in (("last", "the last attempt counts"), ("mean", "all attempts count")):
        season.text = FILE.replace("failures = 2", f'count = "{count}"')
        season.restart()
        season.refuses(Withdraw("alice", 1), why)


@of(IMAGES)
def test_an_image_ends_the_pause_for_what_was_forfeited_and_not_that_of_the_organiser(season: Season) -> None:
    season.attempt("alice", Raising())
    season.attempt("alice")
    assert season.state.entrants["alice"].paused
    season.ask(Submit("alice", IDS[0], "alice:1"))
    assert (season.state.entrants["alice"].paused, season.state.entrants["alice"].failed) == ("", 0)
    season.act("pause", "alice")
    season.ask(Submit("alice", IDS[0], "alice:1"))
    assert season.state.entrants["alice"].paused == "because"


def test_an_image_plays_in_place_of_a_key_once_it_is_submitted(season: Season) -> None:
    alice = Submit("alice", IDS[0], "alice:1")
    season.refuses(alice, "no images are accepted")
    season.text = IMAGES
    season.restart()
    season.refuses(Submit("alice", "alice:latest", "alice:1"), "not the id of an image")
    season.ask(alice)
    season.executor.agents["alice"] = None
    reply = season.ask(Attempt("alice"))
    assert ("hub" in reply, reply["image"]) == (False, True)
    season.turns()
    (job,) = season.executor.jobs.values()
    assert (job.entrant.image, job.entrant.id) == ("alice:1", IDS[0])
    season.ask(Submit("alice", IDS[1], "alice:1"))  # the next attempt is its
    season.restart()
    season.turns()
    (job,) = season.executor.jobs.values()
    assert job.entrant.id == IDS[0]
    season.act("close")  # what has proved itself plays the testing tasks
    season.refuses(alice, "the season closed")


@of(IMAGES)
def test_an_image_is_run_again_as_it_was_and_kept_for_that(season: Season) -> None:
    first, unused, last = IDS
    season.enrol("bob")
    season.ask(Submit("alice", first, "alice:1"))
    season.executor.agents["bob"] = None
    season.attempt("alice", None)
    season.act("exclude", "alice")
    season.act("readmit", "alice")
    season.ask(Submit("alice", unused, "alice:2"))
    season.ask(Submit("alice", last, "alice:3"))
    season.act("rerun", "alice")
    season.turns()
    (job,) = season.executor.jobs.values()
    assert (job.spec.id, job.entrant.id) == ("alice/mines/2", first)
    keys = {season.state.entrants["bob"].act.id}
    assert season.course.images - keys == {first, last}
    season.act("close")
    assert season.course.images - keys == {last}


WALK, STAND = (f'[entrants.{name}]\ncommand = ["true"]\n' for name in ("walk", "stand"))


@of(FILE + STAND)
def test_entrants_of_the_file_play_by_themselves_and_have_pseudonyms(
    season: Season, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    late = tmp_path / "late.toml"
    late.write_text(season.text + WALK)
    wish = addition(season.course, late, b"chance")
    with monkeypatch.context() as damaged:
        damaged.setattr("experiment_runner.competition.season.server.record_acts", None)
        with pytest.raises(TypeError):
            season.act("add", **wish)
    season.turns()  # without who was not admitted
    season.act("add", **wish)
    season.turns()
    assert season.states("walk") == season.states("stand") == {1: "over"}
    entrants = season.state.entrants
    assert len({*entrants, *filter(None, (one.act.alias for one in entrants.values()))}) == 2 * len(entrants)
    with pytest.raises(ExperimentError, match="has changed meanwhile"):
        season.act("add", **wish)
    season.text += WALK
    season.restart()
    with pytest.raises(ExperimentError, match="has no entrant that does not take part already"):
        addition(season.course, late, b"chance")


def test_two_servers_do_not_serve_one_directory(season: Season) -> None:
    with pytest.raises(DirectoryTaken, match="is in use by process"):
        open_competition(season.directory, season.text, season.competition, SECRET)


def test_a_line_of_the_journal_that_a_kill_has_torn_is_written_again(season: Season) -> None:
    season.stack.close()
    journal = season.directory / "journal.jsonl"
    whole = journal.read_bytes()
    journal.write_bytes(whole + whole[:40])
    season.start()
    season.attempt("alice")
    assert season.states("alice") == {1: "over"}
    assert broken(season.store) == ""
    season.stack.close()
    journal.write_bytes(whole)
    with pytest.raises(ExperimentError, match=r"journal\.jsonl"):
        season.start()


@pytest.mark.parametrize(
    ("act", "subject", "number", "why"),
    [
        ("rerun", "alice", 7, "alice has no attempt 7 that is over"),
        ("rerun", "nobody", 0, "there is no entrant nobody"),
        ("rerun", "alice/mines/0", 0, "there is no entrant alice/mines/0"),
        ("grant", "alice", 0, "grant from 1 to 10,000 attempts"),
        ("grant", "nobody", 1, "there is no entrant nobody"),
        ("readmit", "alice", 0, "alice is not excluded"),
        ("resume", "", 0, "the season is not paused"),
        ("resume", "alice", 0, "alice is not paused"),
        ("thaw", "", 0, "the board is not frozen"),
        ("dance", "", 0, "there is no act 'dance'"),
    ],
)
def test_an_act_that_cannot_be_is_refused(
    season: Season, act: str, subject: str, number: int, why: str
) -> None:
    lines = len(season.course.acts)
    with pytest.raises(ExperimentError, match=why):
        season.act(act, subject, number=number)
    assert len(season.course.acts) == lines


def test_an_address_has_a_port_for_each_slot() -> None:
    keys = Path("keys")
    assert gate_of(Gate("tcp://[::]:4097", keys), 3) == Gate("tcp://[::]:4100", keys)
    assert gate_of(Gate("ipc:///run/gate", keys), 1) == Gate("ipc:///run/gate-1", keys)
    for bind in ("tcp://127.0.0.1:*", "tcp://127.0.0.1:65535"):
        with pytest.raises(ConfigError, match="is not an address for 2 attempts at once"):
            gate_of(Gate(bind, keys), 1)


def test_an_organiser_acts_on_a_season_that_nobody_serves(season: Season) -> None:
    season.stack.close()
    organise(season.directory, "grant", subject="alice", number=2, why="a mail of May")
    with pytest.raises(ExperimentError, match="there is no entrant bob"):
        organise(season.directory, "exclude", subject="bob", why="a mail of May")
    season.start()
    assert season.state.entrants["alice"].granted == 2
