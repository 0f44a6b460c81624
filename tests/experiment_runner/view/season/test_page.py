"""The page of a season over HTTP, in this process: who may see what, and what it answers."""

from __future__ import annotations

import json
import struct
from collections.abc import Iterator
from datetime import datetime
from pathlib import Path
from typing import Any

import pytest

from experiment_runner.competition.records.journal import ANNOUNCE, EVERYBODY
from experiment_runner.competition.season.entrance import routes
from experiment_runner.view.guard import HEADERS, Address
from experiment_runner.view.season.page import season_page
from experiment_runner.view.season.views import Views, organisers_token
from tests.experiment_runner.view.pages import Answer, asked
from tests.experiment_runner.view.season.seasons import Held

PORT = 8097
NAMES = ("season.json", "entrants/otter.json", "feed.xml", "replays/otter/1.json")


class Season:
    """A season, and its page in this process."""

    def __init__(self, directory: Path) -> None:
        self.held = Held(directory)
        self.token = self.held.enrol("alice", "otter")
        self.held.enrol("bob", "mole")
        self.held.play("alice", 1, (0, 1, 2))
        self.held.play("bob", 1, (3,), forfeit="the bank is empty")
        self.app = season_page(Views(directory, self.now), Address(PORT), routes)
        self.organiser = organisers_token(directory)

    def now(self) -> datetime:
        """Return the time, which passes with the acts of the season."""
        return self.held.now

    def ask(
        self, path: str, token: str = "", headers: dict[str, str] | None = None, method: str = "GET"
    ) -> Answer:
        """Send a request, with a token if there is one, and the host unless `headers` has another."""
        given = {"Host": f"127.0.0.1:{PORT}"} | ({"Cookie": self.log_in(token)} if token else {})
        return asked(self.app, path, given | (headers or {}), method)

    def log_in(self, token: str) -> str:
        """Exchange a token for a cookie."""
        answer = asked(self.app, f"/?token={token}".replace(" ", "%20"), {"Host": f"127.0.0.1:{PORT}"})
        assert answer.status == 303, answer
        return answer.headers["set-cookie"].partition(";")[0]

    def board(self, token: str = "") -> dict[str, Any]:
        found: dict[str, Any] = self.ask("/season.json", token).json()
        return found


@pytest.fixture(scope="module")
def season(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Season]:
    season = Season(tmp_path_factory.mktemp("runs") / "spring")
    yield season
    season.held.close()


@pytest.fixture
def fresh(tmp_path: Path) -> Iterator[Season]:
    """A season of its own, in which a test may act."""
    season = Season(tmp_path / "spring")
    yield season
    season.held.close()


def test_everybody_may_look_without_a_token(season: Season) -> None:
    for path in ("/", "/static/season/board.js", "/static/style.css", *(f"/{name}" for name in NAMES)):
        assert season.ask(path).status == 200, path


def test_the_public_learns_no_name_no_reason_and_no_score_of_a_hidden_task(season: Season) -> None:
    text = b"".join(season.ask(f"/{name}").body for name in (*NAMES, "entrants/mole.json"))
    for secret in (b"alice", b"bob", b"token", b"deep", b"key of"):
        assert secret not in text
    board = season.board()
    assert {one["name"] for one in board["entrants"]} == {"otter", "mole"}
    assert board["tasks"] == ["mines"]
    assert board["you"] is None
    assert season.ask("/entrants/alice.json").status == 404
    assert season.ask("/replays/alice/1.json").status == 404


def test_an_entrants_token_shows_its_own_row_and_the_organisers_all(season: Season) -> None:
    own = season.board(season.token)
    assert own["you"] == "alice"
    assert "attempts left" in own["left"]
    assert {one["name"] for one in own["entrants"]} == {"alice", "mole"}
    everything = season.board(season.organiser)
    assert {one["name"] for one in everything["entrants"]} == {"alice", "bob"}
    assert everything["tasks"] == ["mines", "deep"]
    assert "what the organiser sees" in everything["state"]


def test_a_wrong_token_shows_no_more_than_everybody_sees(season: Season) -> None:
    refused = season.ask("/?token=wrong")
    assert refused.status == 403
    assert "set-cookie" not in refused.headers
    wrong = {"Cookie": f"glue-season-{PORT}=wrong"}
    assert season.ask("/season.json", headers=wrong).json() == season.board()


def test_one_who_has_just_enrolled_can_log_in_and_still_can_after_a_restart(fresh: Season) -> None:
    token = fresh.held.enrol("carol", "vole")
    assert fresh.board(token)["you"] == "carol"
    cookie = fresh.log_in(token)
    fresh.app = season_page(Views(fresh.held.directory, fresh.now), Address(PORT), routes)
    assert fresh.ask("/season.json", headers={"Cookie": cookie}).json()["you"] == "carol"


def test_the_organisers_token_is_its_owners_alone(season: Season) -> None:
    path = season.held.directory / "page.token"
    assert path.stat().st_mode & 0o777 == 0o600
    assert organisers_token(season.held.directory) == path.read_text().strip()


@pytest.mark.parametrize("method", ["POST", "PUT", "DELETE", "PATCH"])
def test_nothing_but_the_entrance_takes_anything(season: Season, method: str) -> None:
    assert season.ask("/season.json", method=method).status == 405
    answer = season.ask("/season/api/attempt", method=method)
    assert answer.status == (403 if method == "POST" else 405)  # it is not signed


def test_it_has_the_guard_of_every_page(season: Season) -> None:
    answer = season.ask("/season.json", headers={"Host": "evil.example"})
    assert answer.status == 403
    assert HEADERS.items() <= {name: answer.headers.get(name.lower()) for name in HEADERS}.items()


def test_what_has_not_changed_is_not_sent_again(fresh: Season) -> None:
    first = fresh.ask("/season.json")
    tag = {"If-None-Match": first.headers["etag"]}
    assert first.headers["cache-control"] == "no-cache"
    assert fresh.ask("/season.json", headers=tag).status == 304
    fresh.held.act(ANNOUNCE, EVERYBODY, "A <i>break</i>")
    while (changed := fresh.ask("/season.json", headers=tag)).status == 304:
        pass  # a board that was costly to compute is kept for a while
    assert changed.json()["announcements"][0]["text"] == "A <i>break</i>"


def test_a_verified_attempt_is_replayed_but_for_its_hidden_tasks(season: Season) -> None:
    trials = season.ask("/replays/otter/1.json").json()
    assert [(one["task"], one["trial"], len(one["episodes"])) for one in trials] == [
        ("mines", 0, 2),
        ("mines", 1, 2),
    ]
    content = season.ask("/replays/otter/1/mines/1/2").body
    (size,) = struct.unpack_from("<I", content)
    about = json.loads(content[4 : 4 + size])
    assert about["steps"] == trials[1]["episodes"][1][0]
    assert about["recording"] == "otter, attempt 1: mines, trial 1"  # nobody's own name
    for path in (
        "/replays/otter/1/deep/0/1",
        "/replays/otter/1/mines/2/1",
        "/replays/otter/1/mines/0/3",
        "/replays/otter/2.json",
        "/replays/mole/1.json",  # it was forfeited
        "/replays/weasel/1.json",
    ):
        assert season.ask(path).status == 404, path
    assert season.ask("/replays/alice/1/deep/0/1", season.organiser).status == 200


def test_health_says_that_no_server_runs(season: Season) -> None:
    answer = season.ask("/healthz")
    assert answer.status == 503
    assert answer.json() == {"ok": False, "why": "no server answers: nothing is played"}


def test_metrics_count_entrants_and_attempts(season: Season) -> None:
    pytest.importorskip("prometheus_client")
    answer = season.ask("/metrics")
    assert answer.status == 200, answer.body
    lines = answer.body.decode().splitlines()
    assert "glue_season_entrants 2.0" in lines
    assert 'glue_season_attempts{state="over"} 2.0' in lines
    assert "glue_season_up 0.0" in lines
    assert "alice" not in answer.body.decode()


@pytest.mark.parametrize(
    "path",
    [
        "/entrants/..%2f..%2fetc.json",
        "/entrants/%00.json",
        "/replays/otter/99999999999999999999999.json",
        "/replays/otter/1/..%2f/0/1",
        "/static/../guard.py",
        "/page.token",
        "/journal.jsonl",
    ],
)
def test_names_from_the_page_never_reach_the_disk(season: Season, path: str) -> None:
    assert season.ask(path).status == 404
