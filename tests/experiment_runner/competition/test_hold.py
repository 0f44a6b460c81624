"""A competition from its file to its board, with real processes: entrants that end in all possible ways."""

from __future__ import annotations

import csv
import gzip
import io
import os
import random
import re
import shutil
import sqlite3
import struct
import subprocess
import sys
from contextlib import closing
from pathlib import Path

import pytest

from experiment_runner.competition.board.forms import as_csv, as_json, as_text
from experiment_runner.competition.board.standings import Standing, Standings, standings
from experiment_runner.competition.course import course_of
from experiment_runner.competition.records.record import digest, record_path
from experiment_runner.competition.records.seal import check_signature, sign
from experiment_runner.competition.records.verify import verify
from experiment_runner.store.layout import LOCK_FILE, RunLock
from experiment_runner.store.results import Results
from experiment_runner.store.store import Store
from experiment_runner.view.export import as_page
from glue.client.libzmq import new_pair
from glue.errors import ExperimentError, GlueError
from glue.keys.certificates import write_pair
from tests import forked
from tests.experiment_runner.competition.contest import ENTRANT, FILE, compete, write
from tests.experiment_runner.view.pages import Inside
from tests.forked import BIN
from tests.proof import size
from tests.system.runs import wait_until

pytestmark = pytest.mark.slow


def update(run: Path, statement: str, *values: object) -> int:
    """Update the database of a run; return the number of changed rows."""
    with closing(sqlite3.connect(run / "results.sqlite")) as database, database:
        database.execute("PRAGMA foreign_keys = off")
        return database.execute(statement, values).rowcount


@pytest.fixture(scope="module")
def held(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A competition that was held and verified; not to be changed."""
    folder = tmp_path_factory.mktemp("competition")
    write(folder)
    compete(folder, "run", "spring.toml", "--out", "run", "--workers", "3")
    assert "6 of 6 trials are verified" in compete(folder, "verify", "run")
    return folder


@pytest.fixture
def run(held: Path, tmp_path: Path) -> Path:
    """A copy of the run, to be changed."""
    return Path(shutil.copytree(held / "run", tmp_path / "run"))


def board(run: Path, reveal: bool = False) -> Standings:
    with Results.open(run) as results:
        return standings(results, course_of(run), reveal)


def entrants(run: Path) -> dict[str, Standing]:
    return {standing.name: standing for standing in board(run).entrants}


def problems(run: Path) -> list[str]:
    found: list[str] = []
    with Store.open(run) as store:
        verify(store, {task.name: task.steps for task in course_of(run).competition.tasks}, found.append)
    return found


def test_every_entrant_has_its_place_and_every_forfeit_its_reason(held: Path) -> None:
    found = entrants(held / "run")
    reasons = {(name, lost.task): lost.reason for name, one in found.items() for lost in one.forfeits}
    for trial, why in (
        (("crash", "mines"), "status 7"),
        (("crash", "walk"), "status 8"),
        (("raise", "mines"), "<script>"),
        (("raise", "walk"), ""),  # it breaks the protocol, and then ends
    ):
        reason = reasons.pop(trial)
        assert reason
        assert why in reason
    assert not reasons
    assert found["crash"].place == found["raise"].place == 2


def test_a_forfeit_never_beats_a_game_that_was_played_to_its_end(held: Path) -> None:
    """In the mines, walking earns less than standing still, but a forfeit earns no more than walking."""
    (walked,), *forfeited = (
        one.tasks["mines"].trials for _, one in sorted(entrants(held / "run").items(), reverse=True)
    )
    assert walked < -200  # the cost of 200 steps against a wall, which leaving would have avoided
    assert forfeited == [(walked,), (walked,)]


def test_every_form_of_the_board_has_the_entrants_and_seeds_at_the_end_alone(held: Path) -> None:
    with Results.open(held / "run") as results:
        seeds = [str(record.spec.seed) for record in results.trials()]
    hidden, revealed = board(held / "run"), board(held / "run", reveal=True)
    for form in (as_text, as_csv, as_page, as_json):
        assert not any(seed in form(hidden) for seed in seeds)
        assert all(seed in form(revealed) for seed in seeds)
    rows = list(csv.DictReader(io.StringIO(as_csv(hidden))))
    assert {row["entrant"] for row in rows} == {"walk", "crash", "raise"}
    assert all(float(row["low"]) <= float(row["total"]) <= float(row["high"]) for row in rows)
    page = as_page(hidden)
    assert {"table", "svg", "polyline", "h1"} <= set(re.findall(r"<(\w+)", page))
    assert not re.search(r"(?i)<script|<[^>]*\s(src|href|action|data)=", page)
    assert "<b>spring" not in page
    assert "&lt;script&gt;" in page
    assert not re.search("https?:", page.replace('xmlns="http://www.w3.org/2000/svg"', ""))


def test_a_log_is_bounded_and_shows_no_secret(held: Path) -> None:
    logs = list((held / "run" / "logs").rglob("*.log"))
    assert len(logs) == 6
    for log in logs:
        assert log.stat().st_size < 2200
        assert b"SECRET" not in log.read_bytes()
        assert b"['GLUE_HUB', 'GLUE_SESSION']" in log.read_bytes()
    assert (held / "run").stat().st_mode & 0o077 == 0


def test_another_secret_is_another_competition(held: Path) -> None:
    (refused,) = compete(held, "run", "spring.toml", "--out", "run", secret="plugh", status=1).splitlines()
    assert "another secret seed" in refused


def test_a_directory_that_an_organiser_has_left_open_is_closed(run: Path, held: Path) -> None:
    """A kill before the mode is set, or a later change of it, would leave the levels readable."""
    run.chmod(0o755)
    compete(held, "run", "spring.toml", "--out", str(run))
    assert run.stat().st_mode & 0o077 == 0


@pytest.mark.stage("kills")
def test_a_full_disk_is_one_line_and_nothing_recorded_is_lost(tmp_path: Path) -> None:
    """A limit on file sizes simulates the full disk."""
    write(tmp_path, FILE.replace("trials = 1", "trials = 4"))
    command = f"ulimit -f 200; exec {BIN / 'glue-compete'} run spring.toml --out run"
    environment = {**os.environ, "SECRET": "xyzzy"}
    full = subprocess.run(
        ["sh", "-c", command], cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=200
    )
    assert full.returncode == 1
    *told, last = full.stderr.splitlines()
    assert last.startswith("Error: ")
    assert "start the same command again" in last or "resume the run in run" in last
    assert "Traceback" not in full.stderr
    over = [line.split()[1] for line in told if line.startswith("[")]
    again = compete(tmp_path, "run", "spring.toml", "--out", "run")
    assert not any(f"] {trial} " in again for trial in over)
    compete(tmp_path, "verify", "run")


def test_runs_are_shown_and_removed_but_not_merged(run: Path) -> None:
    """Standings need the records; removal leaves neither levels nor logs."""

    def results(command: str, *options: str, status: int = 0) -> str:
        done = forked.run("glue-results", command, str(run), *options, cwd=run.parent, status=status)
        return done.stdout + done.stderr

    assert "walk, mines" in results("show")
    refused = results("merge", "--out", str(run.parent / "merged"), status=1)
    assert f"glue-results export {run}" in refused
    assert not (run.parent / "merged").exists()
    results("export")
    results("remove", "--yes")
    assert not run.exists()


@pytest.mark.proof
def test_random_changes_of_a_record_are_found(run: Path) -> None:
    chance = random.Random(1)
    paths = [record_path(run, trial) for trial in ("walk/mines/0", "crash/mines/0", "walk/walk/0")]
    for number in range(size(6, 100)):
        path = paths[number % len(paths)]
        whole = path.read_bytes()
        place = chance.randrange(len(whole))
        other = bytes([whole[place] ^ chance.randrange(1, 256)])
        rest = (
            other + whole[place + 1 :],
            b"",
            chance.randbytes(chance.randrange(1, 9)) + whole[place:],
            whole[place + 1 :],
        )
        kind = chance.randrange(len(rest))
        path.write_bytes(whole[:place] + rest[kind])
        found = problems(run)
        assert len(found) == 1, (number, kind, place, found)
        assert str(path) in found[0]
        path.write_bytes(whole)
    assert problems(run) == []


def test_a_forged_reward_is_found_by_replay(run: Path) -> None:
    """The checksum and the digest of the record are those of its changed contents."""
    path, reward = record_path(run, "walk/walk/0"), struct.pack("<d", 1.0)
    content = gzip.decompress(path.read_bytes())
    assert reward in content
    path.write_bytes(gzip.compress(content.replace(reward, struct.pack("<d", 100.0), 1)))
    where = "WHERE trial = (SELECT key FROM trials WHERE id = 'walk/walk/0')"
    assert update(run, f"UPDATE outcomes SET digest = ? {where}", digest(path)) == 1
    (problem,) = problems(run)
    assert "walk/walk/0" in problem
    assert "the reward: expected" in problem


def test_a_forged_episode_in_the_database_is_found(run: Path) -> None:
    update(run, "UPDATE episodes SET episode_return = episode_return + 1 WHERE trial = 1 AND episode = 1")
    (problem,) = problems(run)
    assert "in the database" in problem


_FORFEITED = (
    "UPDATE outcomes SET reason = 'it left' WHERE trial = (SELECT key FROM trials WHERE id = 'walk/mines/0')"
)


def test_an_edit_of_the_directory_is_found_by_verify_and_on_the_board(run: Path) -> None:
    """`test_seal.py` makes edits of every kind."""
    assert update(run, _FORFEITED) == 1
    with pytest.raises(ExperimentError, match="were changed") as failure:
        board(run)
    assert "\n" not in str(failure.value)
    assert "were changed" in compete(run.parent, "verify", "run", status=1)


def test_a_signature_shows_others_whose_board_it_is(run: Path) -> None:
    pytest.importorskip("nacl", reason="needs PyNaCl: pip install 'glue-rl[keys]'")
    ours, other = new_pair(), new_pair()
    _, secret = write_pair(run.parent, "organiser", ours)
    with pytest.raises(ExperimentError, match="is not signed"):
        check_signature(run, ours.public)
    compete(run.parent, "verify", "run", "--sign", str(secret))
    assert problems(run) == []  # the signature remains, as nothing has changed
    compete(run.parent, "board", "run", "--signed-by", "organiser.key")
    with pytest.raises(ExperimentError, match="was not signed with"):
        check_signature(run, other.public)
    update(run, _FORFEITED)
    (run / "seal.json").unlink()
    assert problems(run) == []  # organisers can lie to themselves
    sign(run, other)
    (refused,) = compete(run.parent, "board", "run", "--signed-by", "organiser.key", status=1).splitlines()
    assert refused.startswith("Error: ")


_HOSTILE = {
    "deep TOML": ("competition.toml", "x = " + 100_000 * "["),
    "a number of many digits": ("competition.toml", f"trials = {9_000 * '9'}"),
    "a number of many digits in base 16": ("competition.toml", f"trials = 0x{9_000 * 'f'}"),
    "a long competition": ("competition.toml", "#" * 2**21),
    "no text": ("competition.toml", "\udcff"),
    "NaN": ("run.json", '{"program": NaN, "machine": {"a": Infinity, "b": 1e999}}'),
    "half a character": ("run.json", '{"program": "\\ud800"}'),
    "deep JSON": ("run.json", 100_000 * "["),
    "a journal of another kind": ("journal.jsonl", "[NaN]\n"),
    "a seal of another kind": ("seal.json", "[NaN]"),
    "a deep seal": ("seal.json", 100_000 * '{"played":'),
}


def test_a_hostile_directory_is_one_line(run: Path) -> None:
    """On the board and on the page, in a folder whose name is not UTF-8."""
    folder = Path(os.fsdecode(os.fsencode(run.parent) + b"/\xff"))
    for number, (file, text) in enumerate(_HOSTILE.values()):
        made = shutil.copytree(run, folder / f"run{number}")
        (made / file).write_bytes(os.fsencode(text))
        with pytest.raises(GlueError) as failure:
            board(made)
        assert "\n" not in str(failure.value)
    assert len(compete(folder, "board", "run0", status=2).splitlines()) == 1
    page = Inside(folder)
    for number in range(len(_HOSTILE)):
        run_id = page.run_id(f"run{number}")
        assert page.ask(f"/api/standings/{run_id}").status == 422
        assert page.ask(f"/api/run/{run_id}").status == 200
        assert page.ask(f"/api/curves?run={run_id}").status == 200


def test_only_what_was_verified_is_on_the_board(run: Path) -> None:
    path = record_path(run, "walk/mines/0")
    path.write_bytes(path.read_bytes()[:-1])
    assert entrants(run)["walk"].place is None
    assert "changed since it was verified" in entrants(run)["walk"].missing
    assert "walk/mines/0 does not match" in compete(run.parent, "verify", "run", status=1)
    assert "not verified" in entrants(run)["walk"].missing
    assert entrants(run)["crash"].place is not None


def test_check_plays_every_task_and_reports_to_every_owner(tmp_path: Path) -> None:
    short = FILE.replace("steps = 200", "steps = 200, max_steps = 40").replace('"raise"', '"walk"', 1)
    write(tmp_path, short.partition("[entrants.raise]")[0])
    (tmp_path / "check").mkdir()
    lock = RunLock(tmp_path / "check")
    refused = compete(tmp_path, "check", "spring.toml", status=1)
    assert re.search("check is in use by process .*--out", refused)
    lock.release()
    checked = compete(tmp_path, "check", "spring.toml", status=1)
    reports = {path.parent.name: path.read_text() for path in tmp_path.glob("check/*/report.txt")}
    assert set(reports) == {"walk", "crash"}
    assert reports["walk"].count("episode 3: return") == 2
    assert "walk: played 3 episodes of each task" in checked
    assert reports["walk"].count("s of processors; ") == reports["walk"].count("time bank down to ") == 2
    assert "task mines" in reports["crash"]
    assert "status 7" in reports["crash"]
    assert "status 8" in reports["crash"]
    assert all(f"I am {name} ['GLUE_HUB', 'GLUE_SESSION']" in report for name, report in reports.items())
    assert not (tmp_path / "check" / LOCK_FILE).exists()


def test_acts_of_the_organiser_are_sealed_and_shown_and_delete_nothing(run: Path) -> None:
    folder = run.parent
    write(folder)
    before = {path: path.read_bytes() for path in (run / "records").rglob("*.traj")}

    why = ("--reason", "a mail of 3 May")
    assert "a reason is a line" in compete(folder, "exclude", "run", "crash", "--reason", " ", status=2)
    compete(folder, "exclude", "run", "raise", "--reason", "it read <i>mail</i>")
    assert "played again: crash/mines/0" in compete(folder, "rerun", "run", "crash/mines/0", *why)
    assert "1 of 7 trials are not over" in compete(folder, "verify", "run", status=1)
    unchanged = compete(folder, "add", "run", "spring.toml", *why, status=1)
    assert "has no entrant that does not take part already" in unchanged
    with (folder / "spring.toml").open("a") as file:
        file.write(ENTRANT.format(name="late", kind="walk"))
    without = compete(folder, "run", "spring.toml", "--out", "run", status=1)
    assert "entrant late is not in the run yet: glue-compete add" in without
    compete(folder, "add", "run", "spring.toml", *why)
    assert entrants(run)["raise"].missing == "excluded: it read <i>mail</i>"
    assert entrants(run)["crash"].missing == "not played to the end yet"
    assert "not played to the end yet" in entrants(run)["late"].missing
    played = compete(folder, "run", "spring.toml", "--out", "run", "--workers", "2")
    assert "all 6 trials are over" in played  # without those of who was excluded
    assert "9 of 9 trials are verified" in compete(folder, "verify", "run")
    found = entrants(run)
    assert [lost.trial for lost in found["crash"].forfeits] == [0, 0]
    assert found["late"].tasks == found["walk"].tasks
    assert (found["late"].place, found["crash"].place, found["raise"].place) == (1, 3, None)
    assert all(path.read_bytes() == content for path, content in before.items())
    for form in ("text", "html", "json"):
        shown = compete(folder, "board", "run", "--format", form)
        assert "a mail of 3 May" in shown
        assert ("&lt;i&gt;mail" if form == "html" else "<i>mail") in shown


@pytest.mark.stage("kills")
def test_an_organiser_acts_on_a_run_while_it_is_played(tmp_path: Path) -> None:
    """Its entrants wait for the file `go`; nobody waits for those who are excluded."""
    write(tmp_path, go=False)
    command = [str(BIN / "glue-compete"), "run", "spring.toml", "--out", "run", "--workers", "3"]
    with subprocess.Popen(command, cwd=tmp_path, env={**os.environ, "SECRET": "xyzzy"}) as organiser:
        wait_until((tmp_path / "run/control").exists, "the run")
        for act in (("exclude", "run", "raise"), ("pause", "run"), ("announce", "run", "late")):
            more = () if act[0] == "announce" else ("--why", "a mail")
            compete(tmp_path, *act, *more)
        (tmp_path / "go").touch()
        compete(tmp_path, "resume", "run", "--why", "a mail")
        assert organiser.wait(200) == 0
    assert not (tmp_path / "run/control").exists()
    assert "4 of 4 trials are verified" in compete(tmp_path, "verify", "run")
    assert {name for name, one in entrants(tmp_path / "run").items() if one.place} == {"walk", "crash"}


@pytest.mark.parametrize(
    ("old", "new", "why"),
    [
        ('env = "mines"', 'env = "mins"', "did you mean mines"),
        ("random_start", "random_stat", "random_start"),
        (sys.executable, "/no/such/program", "there is no program"),
        ('seed_env = "SECRET"', 'seed_file = "none.txt"', "cannot read the secret seed"),
        ('seed_env = "SECRET"', 'seed_env = "NO_SECRET"', "NO_SECRET"),
    ],
)
def test_a_mistake_is_one_line_that_says_what_to_do(old: str, new: str, why: str, tmp_path: Path) -> None:
    write(tmp_path, FILE.replace(old, new))
    (refused,) = compete(tmp_path, "run", "spring.toml", "--out", "run", status=2).splitlines()
    assert refused.startswith("Error: ")
    assert why in refused
    assert not (tmp_path / "run").exists()  # the next try is not refused
