"""The published files of a season, and the command and the process that serve its page."""

from __future__ import annotations

import json
import os
import signal
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import pytest

from experiment_runner.competition.records.journal import CHANGE, act
from experiment_runner.competition.records.seal import record_acts
from experiment_runner.competition.trials import pseudonym
from experiment_runner.view.launch import season_viewed
from experiment_runner.view.season.publish import Publisher
from experiment_runner.view.season.views import Views
from glue.errors import ExperimentError
from tests.experiment_runner.competition.season.inside import SECRET, Season
from tests.forked import run
from tests.system.runs import children, wait_until

LYNX = pseudonym("alice", SECRET, ())


@pytest.fixture
def season(tmp_path: Path) -> Iterator[Season]:
    """A season in which only alice, a lynx, has enrolled."""
    made = Season(tmp_path)
    with made.stack:
        made.enrol("alice")
        yield made


def publisher(season: Season) -> Publisher:
    return Publisher(Views(season.directory, lambda: season.today), season.folder / "public")


def test_what_has_changed_is_written_and_nothing_else_and_a_link_is_not_followed(season: Season) -> None:
    publisher(season).publish()
    public, other = season.folder / "public", season.folder / "other"
    names = {"index.html", "static", "season.json", "feed.xml", "entrants"}
    assert {path.name for path in public.iterdir()} == names
    board = json.loads((public / "season.json").read_text())
    assert (board["replays"], [one["name"] for one in board["entrants"]]) == (False, [LYNX])
    assert (public / "entrants" / f"{LYNX}.json").is_file()
    assert "alice" not in "".join(path.read_text("utf-8") for path in public.glob("**/*.json"))
    before = (public / "index.html").stat().st_mtime_ns
    other.write_text("mine")
    (public / "season.json").unlink()
    (public / "season.json").symlink_to(other)
    season.act("announce", why="a break")
    publisher(season).publish()
    assert json.loads((public / "season.json").read_text())["announcements"][0]["text"] == "a break"
    assert other.read_text() == "mine"
    assert (public / "index.html").stat().st_mtime_ns >= before


def test_nobody_is_found_by_a_name_that_is_no_longer_shown(season: Season) -> None:
    entrants = season.folder / "public" / "entrants"
    for names, shown in (("own", "alice"), ("pseudonyms", LYNX), ("own", "alice")):
        record_acts(season.store, [act(CHANGE, "names", "", value=f'"{names}"')])
        publisher(season).publish()
        assert [path.name for path in entrants.iterdir()] == [f"{shown}.json"]


def test_a_folder_that_cannot_be_written_is_one_line(season: Season) -> None:
    (season.folder / "public").write_text("a file")
    with pytest.raises(ExperimentError, match="cannot write"):
        publisher(season).publish()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--page", "8097"), "--page is HOST:PORT"),
        (("--page", "127.0.0.1:99999"), "--page is HOST:PORT"),
        (("--page", "0.0.0.0:8097"), "add --insecure"),
        (("--proxy", "lab.example"), "--proxy is an address"),
        (("--proxy-address", "lab.example"), "lab.example is not an IP address"),
        ((), "holds no competition"),
    ],
)
def test_a_mistake_is_one_line(tmp_path: Path, arguments: tuple[str, ...], words: str) -> None:
    done = run("glue-compete", "page", str(tmp_path), *arguments, cwd=tmp_path, status=2 if arguments else 1)
    assert words in done.stderr
    assert "Traceback" not in done.stderr
    assert list(tmp_path.iterdir()) == []


def test_a_page_logs_json_too(tmp_path: Path) -> None:
    done = run("glue-compete", "page", str(tmp_path), "--log-format", "json", cwd=tmp_path)
    (line,) = map(json.loads, done.stderr.splitlines())
    assert line.keys() == {"time", "message"}
    assert "holds no competition" in line["message"]


def test_a_page_that_is_killed_is_started_again_and_ends_with_its_server(season: Season) -> None:
    lines: list[str] = []
    pages = partial(children, os.getpid(), f" page {season.directory}")
    with season_viewed(season.directory, {"page": "127.0.0.1:0", "insecure": False}, lines.append):
        wait_until(pages, "the page's process")
        (first,) = pages()
        os.kill(first, signal.SIGKILL)
        wait_until(lambda: lines and pages(), "another one")
        assert "killed by signal 9" in lines[0]
        assert pages() != [first]
    assert not pages()
