"""Who gets through the entrance of a season, and what is left at it."""

from __future__ import annotations

import io
import os
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager, suppress
from http.client import HTTPConnection
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

pytest.importorskip("nacl", reason="needs PyNaCl: pip install 'glue-rl[keys]'")
pytest.importorskip("uvicorn", reason="needs the extra web")

from starlette.requests import Request

from experiment_runner.competition.records import journal
from experiment_runner.competition.season.control import Attempt, TryLater
from experiment_runner.competition.season.entrance import Denied, Rate, address_of
from experiment_runner.competition.season.trying import competition_of
from glue.client.libzmq import new_pair
from glue.client.season import PREFIX, Page, SeasonBusy, SeasonRefused, join
from glue.errors import ExperimentError
from glue.keys.certificates import encode, write_pair
from tests.experiment_runner.competition.season.gate import FILE, Entrance, entrance, entrance_at, shared
from tests.experiment_runner.competition.season.made import Made
from tests.system.runs import wait_until

__all__ = ["entrance", "shared"]


def test_a_reply_with_which_nobody_can_play_is_refused(entrance: Entrance, tmp_path: Path) -> None:
    _, secret = write_pair(tmp_path, "bob", new_pair())
    hub = encode(new_pair().public)
    entrance.replies = [{"hub_key": "x", "token": "t"}, {"hub_key": hub, "token": "\x1b[2J"}]
    for why in ("without the key of its hubs", "token that no address can hold"):
        with pytest.raises(SeasonRefused, match=why):
            join(Page(entrance.url), "bob", secret)


def test_nobody_joins_with_the_key_of_another(entrance: Entrance) -> None:
    body = f'{{"name": "alice", "key": "{encode(new_pair().public)}"}}'.encode()
    entrance.refuses(403, "not signed with the key", body, what="join")
    entrance.refuses(400, "not a public key", b'{"name": "x", "key": "y"}', what="join")
    assert not entrance.asked


def test_strangers_and_posers_do_not_reach_the_server(entrance: Entrance) -> None:
    right = entrance.headers()
    for headers in (
        {},
        {"Glue-Entrant": "é"},
        {**right, "Glue-Entrant": "bob"},
        {**right, "Glue-Time": "1"},
        entrance.headers(pair=new_pair()),
        entrance.headers(what="withdraw"),
    ):
        assert entrance.ask(headers=headers).status == 403, headers
    posing = [{**entrance.headers(pair=new_pair()), "Glue-Entrant": name} for name in ("alice", "bob")]
    known, unknown = (entrance.ask(headers=headers).json() for headers in posing)
    assert known == unknown  # which names there are is not told
    assert not entrance.asked


def test_a_request_that_was_overheard_cannot_be_sent_again(entrance: Entrance) -> None:
    entrance.replies = [{"state": "waiting", "attempt": 1}]
    headers = entrance.headers()
    assert entrance.ask(headers=headers).status == 200
    entrance.refuses(403, "has come before", headers=headers)
    assert len(entrance.asked) == 1


@pytest.mark.parametrize(
    ("body", "status"),
    [
        (b"[]", 400),
        (b"{", 400),
        (b"[" * 10_000, 400),
        (b'{"attempt": "1"}', 403),
        (b'{"more": 1}', 403),
        (b'{"more": "' + b"x" * 20_000 + b'"}', 413),
    ],
)
def test_a_body_is_a_small_json_object(entrance: Entrance, body: bytes, status: int) -> None:
    assert entrance.ask(body).status == status
    assert not entrance.asked


def test_nobody_asks_for_another_or_for_something_else(entrance: Entrance) -> None:
    body = b'{"do": "withdraw", "entrant": "bob", "attempt": 2}'
    entrance.replies = [{}]
    assert entrance.ask(body).status == 200
    assert entrance.asked == [Attempt("alice", 2)]


def test_a_body_is_the_one_that_was_signed(entrance: Entrance) -> None:
    entrance.refuses(400, "not the one that was signed", b'{"attempt": 1}', headers=entrance.headers())


def test_what_the_server_says_reaches_its_entrant(entrance: Entrance) -> None:
    entrance.replies = [ExperimentError("all 5 attempts of today are used"), TryLater("one waits", 7.2)]
    with pytest.raises(SeasonRefused, match="all 5 attempts"):
        entrance.season.ask("attempt")
    with pytest.raises(SeasonBusy, match="one waits") as caught:
        entrance.season.ask("attempt")
    assert caught.value.seconds == 8


def test_without_a_server_one_is_asked_to_come_again(tmp_path: Path) -> None:
    with entrance_at(tmp_path / "run", server=False) as entrance:
        answer = entrance.ask()
    assert (answer.status, answer.headers["retry-after"]) == (503, "10")
    assert "not running" in answer.json()["error"]


def test_the_tasks_are_told_without_what_is_hidden(entrance: Entrance) -> None:
    told = Page(entrance.url).ask("GET", "tasks")
    assert [(task["name"], task["options"]) for task in told["tasks"]] == [
        ("mines", {"random_start": True}),
        ("secret", {"random_start": False}),
    ]
    found = competition_of(told)
    assert [(task.steps, task.episodes, task.rate) for task in found.tasks] == [(20, 0, 0.0), (0, 3, 50.0)]
    assert found.trials == 2


@pytest.mark.parametrize(
    "change",
    [
        {"tasks": 7},
        {"trials": 10**6},
        {"limits": {"cpus": "many"}},
        {"trials": None},
        {"tasks": [{"name": "x"}]},
    ],
)
def test_tasks_in_another_form_are_refused(entrance: Entrance, change: dict[str, Any]) -> None:
    with pytest.raises(ExperimentError, match="in another form"):
        competition_of({**Page(entrance.url).ask("GET", "tasks"), **change})


def test_no_code_is_loaded_because_a_season_names_it(entrance: Entrance) -> None:
    told = Page(entrance.url).ask("GET", "tasks")
    task = {"name": "x", "env": "subprocess:Popen", "episodes": 1}
    with pytest.raises(ExperimentError, match="not installed here"):
        competition_of({**told, "tasks": [task]})


def left(entrance: Entrance) -> list[str]:
    """Return the files of images that are on their way to the engine; they have no names."""
    found = []
    for descriptor in Path("/proc/self/fd").iterdir():
        with suppress(FileNotFoundError):
            found.append(os.readlink(descriptor))
    return [path for path in found if path.startswith(f"{entrance.folder}/") and path.endswith(" (deleted)")]


@contextmanager
def begun(entrance: Entrance, size: int, content: bytes, method: str, what: str) -> Iterator[HTTPConnection]:
    """Begin to send a request of this size."""
    headers = entrance.headers(b"x" * size, what, method=method) | {"Content-Length": str(size)}
    with closing(HTTPConnection("127.0.0.1", entrance.port, timeout=60)) as connection:
        connection.request(method, PREFIX + what, content, headers)
        yield connection


@pytest.mark.parametrize("what", ["join", "attempt"])
def test_a_body_that_does_not_come_holds_nothing(
    entrance: Entrance, what: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("experiment_runner.competition.season.entrance._JSON_SECONDS", 0.05)
    with begun(entrance, 100, b"{", "POST", what) as connection:
        assert connection.getresponse().status == 408


def test_an_upload_that_comes_too_slowly_holds_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("experiment_runner.competition.season.entrance._GRACE_SECONDS", 0.05)
    with (
        entrance_at(tmp_path / "run") as entrance,
        begun(entrance, 2**20, b"x" * 100, "PUT", "image") as slow,
    ):
        assert slow.getresponse().status == 408
        wait_until(lambda: not left(entrance), "its end")


@pytest.mark.parametrize("fast", [-100, 0, 100])
def test_what_was_signed_for_an_earlier_start_of_the_page_is_to_be_signed_anew(
    tmp_path: Path, fast: float
) -> None:
    """The earlier page may have had the request, whatever the clock of its sender says."""
    with entrance_at(tmp_path / "run") as entrance:
        entrance.replies = [{"state": "waiting", "attempt": 1}]
        season = entrance.season
        overheard = entrance.headers(now=time.time() + fast)
        assert entrance.ask(headers=overheard).status == 200
        entrance.replies = [{"state": "waiting", "attempt": 1}]
        season.ask("attempt")
        entrance.asked.clear()
        entrance.start()
        entrance.refuses(409, "sign it anew", headers=overheard)
        assert not entrance.asked
        entrance.replies = [{"state": "waiting", "attempt": 2}]
        assert season.ask("attempt")["attempt"] == 2


def test_a_machine_that_cannot_keep_an_image_says_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("shutil.disk_usage", lambda path: SimpleNamespace(free=2))
    with entrance_at(tmp_path / "run") as entrance:
        for _ in range(6):  # more than the images that one may send at once: it is not its fault
            with pytest.raises(SeasonBusy, match="cannot keep the image: No space left") as caught:
                entrance.season.submit(io.BytesIO(b"x"))
            assert caught.value.seconds == 600


def test_an_upload_that_stops_half_way_leaves_nothing_and_is_one_at_a_time(tmp_path: Path) -> None:
    with entrance_at(tmp_path / "run") as entrance:
        with begun(entrance, 100_000, b"x" * 50_000, "PUT", "image"):
            wait_until(lambda: len(left(entrance)) == 1, "the upload")
            with pytest.raises(SeasonBusy, match="another image"):
                entrance.season.submit(io.BytesIO(b"x"))
        wait_until(lambda: not left(entrance), "its end")
        assert not entrance.asked


def test_an_upload_that_is_too_large_is_refused_before_it_comes(entrance: Entrance) -> None:
    with pytest.raises(SeasonRefused, match=r"has 2\.0 MiB, and 1 MiB are allowed"):
        entrance.season.submit(io.BytesIO(bytes(2**21)))
    assert not left(entrance)


def test_a_season_may_take_no_images(tmp_path: Path) -> None:
    with (
        entrance_at(tmp_path / "run", FILE.replace("images = true", "images = false")) as entrance,
        pytest.raises(SeasonRefused, match="takes no images"),
    ):
        entrance.season.submit(io.BytesIO(b"x"))


def test_an_excluded_entrant_sends_no_images(tmp_path: Path) -> None:
    made = Made(["alice"], FILE)
    made.act(journal.EXCLUDE, "alice", "the rules")
    with entrance_at(tmp_path / "run") as entrance:
        journal.append(tmp_path / "run", journal.text_of(made.acts).encode())
        with pytest.raises(SeasonRefused, match="alice is excluded: the rules"):
            entrance.season.submit(io.BytesIO(b"x"))


def test_an_entrant_that_asks_too_often_has_to_wait(tmp_path: Path) -> None:
    began = time.time()
    with entrance_at(tmp_path / "run", now=lambda: began) as entrance:
        entrance.replies = [{"state": "waiting", "attempt": 1}] * 30
        season = entrance.season
        for _ in range(30):
            season.ask("attempt", {})
        with pytest.raises(SeasonBusy, match="too many requests"):
            season.ask("attempt", {})
    assert len(entrance.asked) == 30


def test_a_rate_grants_a_burst_and_then_its_share() -> None:
    now = 1000.0
    rate = Rate(2.0, 3, lambda: now)
    for _ in range(3):
        rate.take("alice")
    with pytest.raises(Denied) as caught:
        rate.take("alice")
    assert (caught.value.status, caught.value.seconds) == (429, 0.5)
    rate.take("bob")
    now += 0.5
    rate.take("alice")
    with pytest.raises(Denied):
        rate.take("alice")
    now += 3600
    for _ in range(3):
        rate.take("alice")
    with pytest.raises(Denied):
        rate.take("alice")


def test_a_rate_forgets_those_who_have_rested() -> None:
    now = 0.0
    rate = Rate(1.0, 2, lambda: now)
    for number in range(30_000):
        now += 0.001
        rate.take(f"stranger {number}")
    assert len(rate._used_until) <= 10_000


@pytest.mark.parametrize(
    ("peer", "passed", "counted"),
    [
        ("203.0.113.9", [], "203.0.113.9"),
        ("2001:db8::1:2:3:4", [], "2001:db8::/64"),
        ("::ffff:203.0.113.9", [], "203.0.113.9"),
        ("203.0.113.9", ["198.51.100.1"], "203.0.113.9"),  # says who is no proxy
        ("127.0.0.1", ["198.51.100.1"], "198.51.100.1"),
        ("127.0.0.1", ["192.0.2.7, 198.51.100.1"], "198.51.100.1"),  # it has invented the first
        ("127.0.0.1", ["192.0.2.7", "2001:db8::1"], "2001:db8::/64"),
        ("172.30.97.1", ["192.0.2.7, 198.51.100.1"], "198.51.100.1"),
        ("::ffff:172.30.97.1", ["198.51.100.1"], "198.51.100.1"),
        ("172.30.97.2", ["198.51.100.1"], "172.30.97.2"),
        ("127.0.0.1", ["x" * 1000], "127.0.0.1"),
    ],
)
def test_limits_count_by_the_address_behind_a_proxy_that_is_here_or_named(
    peer: str, passed: list[str], counted: str
) -> None:
    headers = [(b"x-forwarded-for", one.encode()) for one in passed]
    request = Request({"type": "http", "client": (peer, 1), "headers": headers})
    assert address_of(request, "172.30.97.1") == counted
