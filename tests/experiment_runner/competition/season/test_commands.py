"""The commands of an entrant, in front of a season whose replies a test decides."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest

pytest.importorskip("nacl", reason="needs PyNaCl: pip install 'glue-rl[keys]'")
pytest.importorskip("uvicorn", reason="needs the extra web")

from experiment_runner.competition.season.control import Attempt, Enrol, Withdraw
from glue.client.libzmq import new_pair
from glue.client.season import Membership, read_membership
from glue.errors import ExperimentError
from glue.keys.certificates import encode, read_pair
from tests import forked
from tests.experiment_runner.competition.season.gate import FILE, Entrance, entrance, shared

__all__ = ["entrance", "shared"]

TEXT = FILE.partition("secret = ")[0].replace("trials = 2", "trials = 1")


@pytest.fixture(autouse=True)
def member(shared: Entrance, tmp_path: Path) -> None:
    """Write what alice has of the season into the test's folder."""
    shared.membership.write(tmp_path / "season.toml")
    shutil.copy(shared.secret, tmp_path)


def run(folder: Path, *arguments: str, status: int = 0, **settings: str) -> subprocess.CompletedProcess[str]:
    return forked.run(*arguments, cwd=folder, env=settings or None, timeout=100, status=status)


def test_who_joins_has_all_that_is_needed_in_a_file(entrance: Entrance, tmp_path: Path) -> None:
    hub_key = encode(new_pair().public)
    entrance.replies = [
        ExperimentError("that is not the code"),
        {"hub_key": hub_key, "token": "secret", "alias": "red fox"},
    ]
    join = ("glue-compete", "join", entrance.url, "--name", "bob", "--dir", "bob", "--code")
    assert "that is not the code" in run(tmp_path, *join, "lemon", status=1).stderr
    done = run(tmp_path, *join, "lemonade")
    assert f"{entrance.url}/?token=secret" in done.stderr
    assert "red fox" in done.stderr
    written = read_membership(tmp_path / "bob/season.toml")
    assert written == Membership(entrance.url, "bob", tmp_path / "bob/bob.key_secret", hub_key, "secret")
    assert written.key.stat().st_mode & 0o777 == 0o600
    key = encode(read_pair(written.key).public)
    assert entrance.asked == [Enrol("bob", key, "lemon"), Enrol("bob", key, "lemonade")]
    assert "season.toml exists" in run(tmp_path, *join, "lemonade", status=2).stderr


def test_an_attempt_that_an_image_plays_is_waited_for_and_its_result_is_the_output(
    entrance: Entrance, tmp_path: Path
) -> None:
    playing = {"state": "playing", "attempt": 2, "trial": 1, "trials": 1, "session": "alice", "image": True}
    over = {"state": "over", "attempt": 2, "image": True, "score": 7.5, "place": 1, "of": 3, "left": 4}
    entrance.replies = [playing, {"state": "verifying", "attempt": 2}, over]
    done = run(tmp_path, "glue-agent", "random", "--season", "season.toml")
    assert done.stdout == "attempt 2 of your image is over; score 7.5; place 1 of 3; attempts left: 4\n"
    assert "Error" not in done.stderr
    assert done.stderr.count("and not this program") == 1
    assert entrance.asked == [Attempt("alice"), Attempt("alice", 2), Attempt("alice", 2)]


def test_an_attempt_that_is_forfeited_ends_in_failure(entrance: Entrance, tmp_path: Path) -> None:
    entrance.replies = [{"state": "over", "attempt": 2, "outcome": "forfeited", "why": "its bank is empty"}]
    done = run(tmp_path, "glue-agent", "random", "--season", "season.toml", status=1)
    assert done.stdout == "attempt 2 is over; forfeited (its bank is empty)\n"


@pytest.mark.parametrize(
    ("command", "status", "why"),
    [
        ("glue-agent --season season.toml ./jumper", 2, "there is no program './jumper' here"),
        ("glue-agent --season season.toml my.py:Agent", 2, "glue-agent my.py:Agent --season"),
        ("glue-agent chat --season season.toml --url x --model m", 2, "url is an address such as"),
        ("glue-compete join http://x --dir b --name Müller", 2, "cannot be a name"),
        ("glue-compete serve file.toml --out run", 2, "file.toml has no table [season]"),
        ("glue-compete serve file.toml --out run --page foo", 2, "--page is HOST:PORT"),
        ("glue-compete serve file.toml --out run --page 0.0.0.0:8097", 2, "add --insecure"),
        ("glue-compete serve file.toml --out run --page 127.0.0.1:{port}", 2, "choose another port (--page)"),
        ("glue-compete submit agent.tar", 1, "not as docker save writes it"),
        ("glue-compete submit my-agent", 2, "there is no file my-agent, and no docker here"),
    ],
)
def test_a_mistake_costs_no_attempt(
    entrance: Entrance, tmp_path: Path, command: str, status: int, why: str
) -> None:
    text = FILE.partition("[season]")[0] + "tasks.a = { env = 'mines', steps = 9 }\n"
    (tmp_path / "file.toml").write_text(text + "entrants.a = { command = ['true'] }\n")
    (tmp_path / "agent.tar").write_bytes(b"no image" * 100)
    arguments = command.format(port=entrance.port).split()
    done = run(tmp_path, *arguments, status=status, SECRET="nobody knows", PATH="/nowhere")
    assert why in done.stderr
    assert not (tmp_path / "run").exists()
    assert not entrance.asked


def test_an_attempt_is_withdrawn(entrance: Entrance, tmp_path: Path) -> None:
    entrance.replies = [{}]
    run(tmp_path, "glue-compete", "withdraw", "3")
    assert entrance.asked == [Withdraw("alice", 3)]


@pytest.mark.slow
def test_an_agent_is_tried_at_home(entrance: Entrance, tmp_path: Path) -> None:
    done = run(tmp_path, "glue-compete", "try", "random")
    assert "mines, trial 1 of 1: score -" in done.stderr
    assert "time bank down to 60.00 of 60 s" in done.stderr
    (tmp_path / "bad.py").write_text(
        "class Bad:\n    def agent_start(self, observation): raise ValueError('no')\n"
    )
    run(tmp_path, "glue-compete", "try", "bad.py:Bad", status=1)
    assert not entrance.asked
