"""The page of a season over HTTP, in this process: who may see what, and what it answers."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from starlette.types import Receive, Scope, Send

from experiment_runner.competition.season.entrance import routes
from experiment_runner.competition.trials import pseudonym
from experiment_runner.view.guard import ADMIT, HEADERS, Address
from experiment_runner.view.season.page import season_page
from experiment_runner.view.season.views import Views, organisers_token
from tests.experiment_runner.competition.season import inside
from tests.experiment_runner.competition.season.inside import SECRET, Raising, Season
from tests.experiment_runner.view.pages import Answer, asked, unpacked

PORT = 8097
FILE = (
    inside.FILE.replace("steps = 20", "episodes = 2, max_steps = 30")
    + 'deep = { env = "mines", options.random_start = true, episodes = 1, max_steps = 20, '
    + 'phase = "proving", hidden = true }\n'
)
OTTER, MOLE = (pseudonym(name, SECRET, ()) for name in ("alice", "bob"))
NAMES = ("season.json", f"entrants/{OTTER}.json", "feed.xml", f"replays/{OTTER}/1.json")


class Shown:
    """A season in which alice, an otter, has played and bob, a mole, has forfeited, and its page."""

    def __init__(self, folder: Path) -> None:
        self.held = Season(folder, FILE)
        self.directory = self.held.directory
        self.token, _ = self.held.enrol("alice", "bob")
        self.held.attempt("alice")
        self.held.attempt("bob", Raising())
        self.organiser = organisers_token(self.directory)
        self.start()

    def start(self) -> None:
        """Start the page."""
        self.app = season_page(Views(self.directory, lambda: self.held.today), Address(PORT), routes)

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
def season(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Shown]:
    """Nobody is to enrol or to play in it."""
    shown = Shown(tmp_path_factory.mktemp("spring"))
    with shown.held.stack:
        yield shown


def test_everybody_may_look_without_a_token(season: Shown) -> None:
    for path in ("/", "/static/season/board.js", "/static/style.css", *(f"/{name}" for name in NAMES)):
        assert season.ask(path).status == 200, path


def test_the_public_learns_no_name_no_reason_and_no_score_of_a_hidden_task(season: Shown) -> None:
    text = b"".join(season.ask(f"/{name}").body for name in (*NAMES, f"entrants/{MOLE}.json"))
    for secret in ("alice", "bob", season.token, "deep", season.held.state.entrants["alice"].act.id):
        assert secret.encode() not in text
    board = season.board()
    assert {one["name"] for one in board["entrants"]} == {OTTER, MOLE}
    assert board["tasks"] == ["mines"]
    assert board["you"] is None
    assert season.ask("/entrants/alice.json").status == 404
    assert season.ask("/replays/alice/1.json").status == 404


def test_an_entrants_token_shows_its_own_row_and_the_organisers_all(season: Shown) -> None:
    own = season.board(season.token)
    assert own["you"] == "alice"
    assert "attempts left" in own["left"]
    assert {one["name"] for one in own["entrants"]} == {"alice", MOLE}
    everything = season.board(season.organiser)
    assert {one["name"] for one in everything["entrants"]} == {"alice", "bob"}
    assert everything["tasks"] == ["mines", "deep"]
    assert "what the organiser sees" in everything["state"]


def test_no_connection_is_kept_but_the_organisers(season: Shown) -> None:
    """Whoever has enrolled could hold a thousand."""
    kept: list[str] = []

    async def app(scope: Scope, receive: Receive, send: Send) -> None:
        await season.app({**scope, "state": {ADMIT: lambda: kept.append(token)}}, receive, send)

    for token in (season.token, season.organiser):
        cookie = {"Host": f"127.0.0.1:{PORT}", "Cookie": season.log_in(token)}
        assert asked(app, "/season.json", cookie).status == 200
    assert kept == [season.organiser]


def test_a_wrong_token_shows_no_more_than_everybody_sees(season: Shown) -> None:
    refused = season.ask("/?token=wrong")
    assert refused.status == 403
    assert "set-cookie" not in refused.headers
    wrong = {"Cookie": f"glue-season-{PORT}=wrong"}
    assert season.ask("/season.json", headers=wrong).json() == season.board()


def test_the_organisers_token_is_its_owners_alone(season: Shown) -> None:
    path = season.directory / "page.token"
    assert path.stat().st_mode & 0o777 == 0o600
    assert organisers_token(season.directory) == path.read_text().strip()


@pytest.mark.parametrize("method", ["POST", "PUT", "DELETE", "PATCH"])
def test_nothing_but_the_entrance_takes_anything(season: Shown, method: str) -> None:
    assert season.ask("/season.json", method=method).status == 405
    answer = season.ask("/season/api/attempt", method=method)
    assert answer.status == (403 if method == "POST" else 405)  # it is not signed


def test_it_has_the_guard_of_every_page(season: Shown) -> None:
    answer = season.ask("/season.json", headers={"Host": "evil.example"})
    assert answer.status == 403
    assert HEADERS.items() <= {name: answer.headers.get(name.lower()) for name in HEADERS}.items()


def test_what_has_not_changed_is_not_sent_again(season: Shown) -> None:
    first = season.ask("/season.json")
    tag = {"If-None-Match": first.headers["etag"]}
    assert first.headers["cache-control"] == "no-cache"
    assert season.ask("/season.json", headers=tag).status == 304
    season.held.act("announce", why="A <i>break</i>")
    while (changed := season.ask("/season.json", headers=tag)).status == 304:
        pass  # a board that was costly to compute is kept for a while
    assert changed.json()["announcements"][0]["text"] == "A <i>break</i>"


def test_a_verified_attempt_is_replayed_but_for_its_hidden_tasks(season: Shown) -> None:
    trials = season.ask(f"/replays/{OTTER}/1.json").json()
    assert [(one["task"], one["trial"], len(one["episodes"])) for one in trials] == [
        ("mines", 0, 2),
        ("mines", 1, 2),
    ]
    about, _ = unpacked(season.ask(f"/replays/{OTTER}/1/mines/1/2").body)
    assert about["steps"] == trials[1]["episodes"][1][0]
    assert about["recording"] == f"{OTTER}, attempt 1: mines, trial 1"  # nobody's own name
    for path in (
        f"{OTTER}/1/deep/0/1",
        f"{OTTER}/1/mines/2/1",
        f"{OTTER}/1/mines/0/3",
        f"{OTTER}/2.json",
        f"{MOLE}/1.json",  # it was forfeited
        "weasel/1.json",
    ):
        assert season.ask(f"/replays/{path}").status == 404, path
    assert season.ask("/replays/alice/1/deep/0/1", season.organiser).status == 200


def test_health_says_that_no_server_runs(season: Shown) -> None:
    answer = season.ask("/healthz")
    assert answer.status == 503
    assert answer.json() == {"ok": False, "why": "no server answers: nothing is played"}


def test_metrics_count_entrants_and_attempts(season: Shown) -> None:
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
        f"/replays/{OTTER}/99999999999999999999999.json",
        f"/replays/{OTTER}/1/..%2f/0/1",
        "/static/../guard.py",
        "/page.token",
        "/journal.jsonl",
    ],
)
def test_names_from_the_page_never_reach_the_disk(season: Shown, path: str) -> None:
    assert season.ask(path).status == 404


def test_one_who_has_just_enrolled_can_log_in_and_still_can_after_a_restart(tmp_path: Path) -> None:
    season = Shown(tmp_path)
    with season.held.stack:
        (token,) = season.held.enrol("carol")
        assert season.board(token)["you"] == "carol"
        cookie = season.log_in(token)
        season.start()
        assert season.ask("/season.json", headers={"Cookie": cookie}).json()["you"] == "carol"
