"""An entrant's side of a season: its file, the course of an attempt, and the relay for other languages."""

from __future__ import annotations

import json
import threading
from collections.abc import Callable, Iterator
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("nacl", reason="needs PyNaCl: pip install 'glue-rl[keys]'")

from glue.client.libzmq import Relay, new_pair
from glue.client.players import serve_agent
from glue.client.season import Membership, Page, Progress, Season, SeasonBusy, SeasonRefused, read_membership
from glue.client.target import OwnKey, Target
from glue.errors import ConfigError
from glue.hub.config import Bind, HubConfig, Keys, Permit
from glue.hub.io.inside import InsideTransport
from glue.hub.io.server import Hub
from glue.keys.certificates import encode, write_pair
from glue.keys.requests import SIGNATURE
from glue.wire.messages import Role

HUB_KEY = encode(new_pair().public)


class Script:
    """A page that gives planned answers.

    Attributes:
        answers: status and body of the next answers, in order; the last one is given again and again.
        asked: path and body of the requests.
        cut: bytes of the next answer that do not come, as when the page is killed.
        slept: how long the entrant's program has slept each time.
        said: what it has been told.
    """

    def __init__(self) -> None:
        self.answers: list[tuple[int, Any]] = []
        self.asked: list[tuple[str, Any]] = []
        self.signatures: list[str | None] = []
        self.retry_after = "7"
        self.cut = 0
        self.url = ""
        self.slept: list[float] = []
        self.said: list[str] = []


@pytest.fixture
def script() -> Iterator[Script]:
    script = Script()

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            self.send_response(200)
            self.end_headers()
            self.wfile.write(b'{"start": "first"}')

        def do_POST(self) -> None:
            content = self.rfile.read(int(self.headers["Content-Length"]))
            script.asked.append((self.path, json.loads(content)))
            script.signatures.append(self.headers[SIGNATURE])
            status, body = script.answers.pop(0) if len(script.answers) > 1 else script.answers[0]
            data = body if isinstance(body, bytes) else json.dumps(body).encode()
            self.send_response(status)
            self.send_header("Retry-After", script.retry_after)
            self.send_header("Location", "https://x")
            if script.cut:
                self.send_header("Content-Length", str(len(data) + script.cut))
                script.cut = 0
            self.end_headers()
            self.wfile.write(data)

        def log_message(self, *_: object) -> None:
            pass

    with HTTPServer(("127.0.0.1", 0), Handler) as server:
        thread = threading.Thread(target=server.serve_forever, args=(0.01,))
        thread.start()
        script.url = f"http://127.0.0.1:{server.server_port}"
        try:
            yield script
        finally:
            server.shutdown()
            thread.join()


@pytest.fixture
def season(script: Script, tmp_path: Path) -> Season:
    _, secret = write_pair(tmp_path, "alice", new_pair())
    return Season(Membership(script.url, "alice", secret, HUB_KEY, "t"), script.slept.append)


PLAYING = {"state": "playing", "attempt": 3, "hub": "tcp://0.0.0.0:4098", "session": "alice", "trials": 2}
OVER: dict[str, Any] = {"state": "over", "attempt": 3, "score": 12.5}


def test_an_attempt_waits_and_plays_each_trial_and_ends(script: Script, season: Season) -> None:
    script.answers = [
        (200, {"state": "waiting", "attempt": 3, "place": 40}),
        (200, {"state": "waiting", "attempt": 3, "place": 2}),
        (200, {**PLAYING, "trial": 1}),
        (200, {**PLAYING, "trial": 1}),  # asked by the player itself, as the next
        (200, {**PLAYING, "trial": 2}),
        (200, {**PLAYING, "trial": 2}),
        (200, {"state": "verifying", "attempt": 3}),
        (200, {"state": "verifying", "attempt": 3}),
        (200, OVER),
    ]
    played: list[Target] = []

    def serve(target: Target, on: Callable[[], bool]) -> None:
        played.append(target)
        while on():  # until it hears that its trial is over
            pass

    assert season.play(serve, script.said.append) == Progress(**OVER)
    assert [(one.hub, one.session) for one in played] == [("tcp://127.0.0.1:4098", "alice")] * 2
    assert [body for _, body in script.asked] == [{"attempt": 0}] + [{"attempt": 3}] * 8
    assert script.said[0] == "attempt 3 waits, place 40 in the queue"
    assert script.said[-2:] == [
        "attempt 3 is played, trial 2 of 2",
        "attempt 3 has been played, and is being verified",
    ]
    assert script.slept == [10.0, 2, 1.0, 1.0, 1.0]
    assert len(set(script.signatures)) == 9


def test_a_page_that_is_restarted_is_asked_again(script: Script, season: Season) -> None:
    script.answers = [(503, {"error": "not running"}), (429, {"error": "too many"}), (200, OVER)]
    assert season.play(None, script.said.append) == Progress(**OVER)
    assert script.said == ["not running; asking again"]
    assert script.slept == [7.0, 7.0]


def test_an_answer_that_breaks_off_is_asked_for_again(script: Script, season: Season) -> None:
    script.answers, script.cut = [(200, b'{"state": '), (200, OVER)], 10
    assert season.play(None, script.said.append) == Progress(**OVER)
    assert "IncompleteRead" in script.said[0]


def test_an_attempt_that_the_season_failed_is_followed_by_another(script: Script, season: Season) -> None:
    script.answers = [(200, {"state": "waiting", "attempt": 3, "why": "a new disk"})]
    script.answers += [(200, {"state": "verifying", "attempt": 4}), (200, {**OVER, "attempt": 4})]
    assert season.play(None, script.said.append).attempt == 4
    assert script.said[0] == "attempt 3 waits, and nothing is played now: a new disk"
    assert [body["attempt"] for _, body in script.asked] == [0, 3, 3]
    ours = {"state": "over", "attempt": 5, "outcome": "ours", "why": "a disk was full"}
    script.answers = [(200, ours)]  # nothing follows, as when the season was closed
    assert str(season.play(None, script.said.append)) == "attempt 5 is over; ours (a disk was full)"


def test_a_page_that_stays_away_is_given_up(script: Script, season: Season) -> None:
    script.answers = [(503, {"error": "not running"})]
    with pytest.raises(SeasonBusy, match="not running"):
        season.play(None, script.said.append)
    assert 590 < sum(script.slept) <= 600


def test_who_has_no_attempt_left_today_is_not_kept_waiting(script: Script, season: Season) -> None:
    script.retry_after = "40000"
    script.answers = [(429, {"error": "no attempts are left: 2 of 2 used, the next on Tuesday"})]
    with pytest.raises(SeasonBusy, match="the next on Tuesday"):
        season.play(None, script.said.append)
    assert script.slept == []


@pytest.mark.parametrize(
    ("answer", "why"),
    [
        ((403, {"error": "all attempts of today are used, more at 00:00"}), "all attempts of today"),
        ((200, {"hello": 1}), "no attempt"),
        ((404, b"<html>"), "answered 404, not as a season does: <html>"),
        ((200, {"state": "over", "attempt": 1, "score": 10**400}), "no attempt"),
        ((200, {"state": "resting", "attempt": 1}), r"no attempt: Invalid enum value 'resting'"),
        ((302, b""), "leads to https://x: give the address"),
        ((200, b"[" * 10_000), "not as a season"),
        ((403, {"error": "\x1b[2Jcleared"}), r"^\?\[2Jcleared"),
    ],
)
def test_any_other_answer_ends_the_attempt(
    script: Script, season: Season, answer: tuple[int, Any], why: str
) -> None:
    script.answers = [answer]
    with pytest.raises(SeasonRefused, match=why):
        season.play(None, script.said.append)


def test_an_address_is_that_of_a_page() -> None:
    assert Page("season.example").url == "http://season.example"
    assert Page("https://season.example/rl/?token=t").url == "https://season.example/rl"
    for url in ("ftp://x", "", "http://", "http://x:y", "http://u:p@x", "http://é", "x y", "http://[::1"):
        with pytest.raises(ConfigError, match="not the address of a page"):
            Page(url)


def test_a_membership_is_read_as_it_was_written(tmp_path: Path) -> None:
    written = Membership("http://x", "alice", tmp_path / "alice.key_secret", 'a"\\b', "tök\n")
    written.write(tmp_path / "season.toml")
    assert (tmp_path / "season.toml").stat().st_mode & 0o777 == 0o600
    assert read_membership(tmp_path / "season.toml") == written
    with pytest.raises(ConfigError, match="File exists"):
        written.write(tmp_path / "season.toml")


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("name = 'x'", "missing required field `page`"),
        ("page = 1", "Expected `str`"),
        ("[", "Invalid initial"),
    ],
)
def test_a_membership_that_is_none_says_what_it_lacks(tmp_path: Path, text: str, why: str) -> None:
    path = tmp_path / "season.toml"
    path.write_text(text)
    path.chmod(0o600)
    with pytest.raises(ConfigError, match=why):
        read_membership(path)


@pytest.mark.parametrize(
    ("reply", "line"),
    [
        (
            Progress("over", 3, score=12.5, low=13.0, high=15.25, place=2, of=7),
            "attempt 3 is over; score 12.5; place 2 of 7 (95 % interval of what counts: 13 to 15.25)",
        ),
        (
            Progress("over", 4, "its bank is empty", outcome="forfeited", left=1, returns="2026-12-02"),
            "attempt 4 is over; forfeited (its bank is empty); attempts left: 1, new ones at 2026-12-02",
        ),
        (Progress("over", 5, left=0), "attempt 5 is over; attempts left: 0"),
    ],
)
def test_a_result_is_a_line(reply: Progress, line: str) -> None:
    assert str(reply) == line


def test_a_program_without_keys_plays_through_a_relay(tmp_path: Path) -> None:
    from agents.baselines import RandomAgent
    from env_server.toys import MinesEnvironment
    from glue.client.experiment import connect_over

    hub_pair, alice = new_pair(), new_pair()
    _, secret = write_pair(tmp_path, "alice", alice)
    permit = Permit("alice", frozenset({Role.AGENT}), frozenset({"alice"}))
    bind = Bind(
        "tcp://127.0.0.1:*",
        frozenset({Role.AGENT}),
        frozenset({"alice"}),
        Keys(hub_pair.secret, {alice.public: permit}),
    )
    with Hub(HubConfig(bind=(bind,))).in_background() as hub:
        transport = InsideTransport(hub, {Role.ENVIRONMENT: MinesEnvironment()}, "alice")
        target = Target(hub.endpoints[0], "alice", OwnKey(secret, alice, hub_pair.public))
        local = f"ipc://{tmp_path}/hub"
        with Relay(local, target), connect_over(transport, "alice") as glue:
            player = threading.Thread(target=serve_agent, args=(RandomAgent(), local, "alice"), daemon=True)
            player.start()
            glue.wait_for_players(lambda missing: None)
            glue.rl_init(1)
            ends = [glue.rl_episode(50) for _ in range(3)]
            hub.stop("the experiment is over")
            player.join(60)
    assert not player.is_alive()
    assert len(ends) == 3
