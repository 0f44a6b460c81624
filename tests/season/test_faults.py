"""What a season survives: a full disk, many strangers, a worker that has to be stopped at once."""

from __future__ import annotations

import hashlib
import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

pytest.importorskip("nacl", reason="needs PyNaCl: pip install 'glue-rl[keys]'")

from experiment_runner.competition.course import course_of
from experiment_runner.competition.match import Match
from experiment_runner.competition.season.control import Attempt, Enrol, ask
from experiment_runner.competition.settings import Entrant
from experiment_runner.competition.trials import trials
from experiment_runner.competition.worker import MODULE, REPORTS
from experiment_runner.executors.workers import LocalExecutor
from experiment_runner.store.results import Results
from glue.keys.certificates import encode
from tests import forked
from tests.experiment_runner.competition.players import SECRET, competition
from tests.experiment_runner.competition.season.inside import CODE, FILE, Season
from tests.forked import BIN
from tests.proof import size
from tests.system.runs import wait_until

ROOT = Path(__file__).parents[2]

_FILE = """\
name = "spring"
trials = 6
seed_file = "secret.txt"
[season]
opens = 2020-01-01T00:00:00
closes = 2100-01-01T00:00:00
enrol = "closed"
parallel = 2
[tasks]
mines = { env = "mines", options.random_start = true, steps = 200, phase = "proving" }
""" + "".join(
    f'[entrants.walk{number}]\ncommand = ["{sys.executable}", "-m", "tests.season.walk"]\n'
    for number in range(3)
)


def over(directory: Path) -> set[str]:
    with Results.open(directory) as results:
        return set(results.outcomes())


@pytest.mark.timeout(600)
def test_a_full_disk_stops_the_server_and_nothing_that_is_over_is_lost(tmp_path: Path) -> None:
    """A limit on file sizes simulates the full disk: of a record, of the database, of the journal or seal."""
    (tmp_path / "spring.toml").write_text(_FILE)
    (tmp_path / "secret.txt").write_text("xyzzy")
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    serve = f"exec {BIN / 'glue-compete'} serve spring.toml --out run"
    kept: set[str] = set()
    for blocks in (200, 260):  # of 512 bytes
        limited = ["sh", "-c", f"ulimit -f {blocks}; {serve}"]
        full = subprocess.run(
            limited, cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=200
        )
        assert full.returncode == 1, full.stderr
        assert full.stderr.splitlines()[-1].startswith("Error: ")
        assert "Traceback" not in full.stderr
        assert kept <= over(tmp_path / "run")
        kept = over(tmp_path / "run")
    server = subprocess.Popen(["sh", "-c", serve], cwd=tmp_path, env=environment)

    def done() -> bool:
        attempts = course_of(tmp_path / "run").state.attempts("over")
        return {one.entrant for one in attempts} == {"walk0", "walk1", "walk2"}

    try:
        wait_until(done, "the attempts")
        assert ask(tmp_path / "run", {"do": "act", "act": "close", "why": "it is over"})["ok"]
        assert server.wait(60) == 0
    finally:
        server.kill()
    assert kept <= over(tmp_path / "run")
    forked.run("glue-compete", "verify", "run", cwd=tmp_path, status=0)


@pytest.mark.proof
def test_many_enrol(tmp_path: Path) -> None:
    many = size(1_000, 10_000)
    season = Season(tmp_path, FILE.replace("failures = 2", f"failures = 2\nmost_entrants = {many}"))
    with season.stack:
        for number in range(many):
            key = encode(hashlib.sha256(str(number).encode()).digest())
            season.ask(Enrol(f"entrant{number}", key, CODE))
        with pytest.raises(Exception, match="there is no room for more"):
            season.enrol("late")
        aliases = {one.act.alias for one in season.state.entrants.values()}
        assert len(aliases) == many
        assert season.ask(Attempt("entrant500"))["state"] == "playing"


def test_a_worker_that_is_cancelled_ends_at_once_and_says_nothing_more(tmp_path: Path) -> None:
    held = competition("alice")
    (spec,) = trials(held, SECRET)
    (tmp_path / "folder").mkdir()
    entrant = Entrant("alice", folder=tmp_path / "folder")
    with LocalExecutor(2, MODULE, REPORTS, warm=["mines"]) as executor:
        executor.start(Match(spec, entrant, held.limits, 20, tmp_path / "log", "test"))
        socket = tmp_path / "folder" / "walk-0" / "hub"
        wait_until(socket.exists, "the hub")
        executor.cancel(spec.id)
        until = time.monotonic() + 1
        while time.monotonic() < until:
            assert executor.receive(0.2) == []
