"""Access to the page, in a table of requests."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from experiment_runner.view.catalog import read_notes
from experiment_runner.view.guard import HEADERS, Address
from tests.experiment_runner.view.pages import Inside
from tests.experiment_runner.view.test_stream import make_run
from tests.forked import run

EVERYTHING = ("/", "/static/main.js", "/api/stream?topic=runs", "/api/run/0", "/nothing")
METHODS = ("GET", "HEAD", "POST", "PUT", "DELETE", "PATCH", "OPTIONS", "TRACE", "PROPFIND")


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Inside:
    return Inside(tmp_path_factory.mktemp("runs"))


def test_the_token_is_exchanged_for_a_cookie_that_scripts_and_other_sites_do_not_get(page: Inside) -> None:
    answer = page.ask(f"/?token={page.token}", {"Cookie": ""})
    assert answer.status == 303
    assert answer.headers["location"] == "./"  # the token does not remain in the address
    cookie = answer.headers["set-cookie"].lower()
    assert {"httponly", "samesite=strict", "path=/"} <= {part.strip() for part in cookie.split(";")}
    assert page.token.lower() not in cookie
    assert page.ask("/").status == 200


@pytest.mark.parametrize("path", EVERYTHING)
@pytest.mark.parametrize("cookie", ["", "glue-view-{port}=", "glue-view-{port}=wrong", '="', "\x80"])
def test_nothing_is_answered_without_the_cookie(page: Inside, path: str, cookie: str) -> None:
    answer = page.ask(path, {"Cookie": cookie.format(port=page.port)})
    assert answer.status == 403
    assert b"<" not in answer.body


@pytest.mark.parametrize("token", ["", "wrong", "%e2%98%83", "%ff", "a" * 5000])
def test_a_wrong_token_opens_nothing(page: Inside, token: str) -> None:
    answer = page.ask(f"/?token={token}", {"Cookie": ""})
    assert answer.status in (400, 403)
    assert "set-cookie" not in answer.headers


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("path", EVERYTHING)
def test_host_and_origin_are_checked_on_every_method(page: Inside, method: str, path: str) -> None:
    for headers in (
        {"Host": "evil.example"},
        {"Host": f"evil.example:{page.port}"},
        {"Host": f"127.0.0.1.evil.example:{page.port}"},
        {"Host": "127.0.0.1"},
        {"Host": f"192.0.2.1:{page.port}"},
        {"Host": ""},
        {"Origin": "null"},
        {"Origin": "http://evil.example"},
        {"Origin": "http://127.0.0.1:1"},
        {"Origin": f"ftp://127.0.0.1:{page.port}"},
        {"Sec-Fetch-Site": "cross-site", "Sec-Fetch-Mode": "no-cors"},
    ):
        assert page.ask(path, headers, method).status == 403, headers


@pytest.mark.parametrize("method", [name for name in METHODS if name not in ("GET", "HEAD")])
def test_only_reading_is_allowed(page: Inside, method: str) -> None:
    origin = {"Origin": f"http://127.0.0.1:{page.port}"}
    answer = page.ask("/api/run/0", origin, method)
    assert answer.status == 405
    assert answer.headers["allow"] == "GET, HEAD"


def test_only_the_page_itself_writes_and_only_notes(tmp_path: Path) -> None:
    make_run(tmp_path / "run").close()
    page = Inside(tmp_path)
    path, own = f"/api/notes/{page.run_id('run')}", {"Origin": f"http://127.0.0.1:{page.port}"}
    good = json.dumps({"note": "x", "tags": ["a", " a", ""]}).encode()
    for headers in ({}, {**own, "Cookie": ""}, {"Origin": "http://evil.example"}):
        assert page.ask(path, headers, "PUT", good).status == 403
    assert page.ask(path, own, "PUT", good).json() == {"note": "x", "tags": ["a"]}
    for content, status in (
        (b"x" * 20_000, 413),
        (b"{", 422),
        (b'{"note": 1, "tags": []}', 422),
        (json.dumps({"note": "", "tags": ["x" * 41]}).encode(), 422),
        (b"[" * 10_000, 422),
    ):
        assert page.ask(path, own, "PUT", content).status == status
    assert page.ask("/api/notes/0", own, "PUT", good).status == 404
    assert page.ask("/api/run/0", own, "PUT", good).status == 405
    assert sorted(one.name for one in tmp_path.iterdir()) == ["run"]
    assert read_notes(tmp_path / "run") == {"note": "x", "tags": ["a"]}
    (tmp_path / "run/notes.json").unlink()
    (tmp_path / "run/notes.json").symlink_to("/etc/passwd")
    assert read_notes(tmp_path / "run") == {"note": "", "tags": []}


def test_names_of_this_machine_may_be_used(page: Inside) -> None:
    for host in ("127.0.0.1", "localhost", "LocalHost", "[::1]"):
        headers = {"Host": f"{host}:{page.port}", "Origin": f"http://{host}:{page.port}"}
        assert page.ask("/", headers).status == 200
    assert page.ask("/", {"Sec-Fetch-Site": "cross-site", "Sec-Fetch-Mode": "navigate"}).status == 200


@pytest.mark.parametrize("path", EVERYTHING)
def test_every_answer_carries_the_policy(page: Inside, path: str) -> None:
    for headers in ({}, {"Cookie": ""}, {"Host": "evil.example"}):
        if path.startswith("/api/stream") and not headers:
            continue  # it does not end; it is an answer like the others
        found = dict(page.ask(path, headers).headers)
        assert {name: found.get(name.lower()) for name in HEADERS} == dict(HEADERS)
        assert "server" not in found
    policy = HEADERS["Content-Security-Policy"]
    assert "default-src 'none'" in policy
    assert "unsafe" not in policy
    assert "http" not in policy


@pytest.mark.parametrize(
    "path",
    [
        "/static/../guard.py",
        "/static/%2e%2e/guard.py",
        "/static/..%2fguard.py",
        "/static//etc/passwd",
        "/static/%00",
        "//etc/passwd",
        "/api/run/..%2f..%2fetc",
        "/api/run/%2fetc",
        "/api/run/.",
        "/api/run/%00",
        "/api/stream?topic=..",
        "/api/stream",
        "/api/stream?" + "&".join(f"topic=runs:{i}" for i in range(20)),
    ],
)
def test_names_from_the_page_never_reach_the_disk(page: Inside, path: str) -> None:
    assert page.ask(path).status in (400, 404)


def test_behind_a_proxy_its_name_counts_and_off_loopback_any_ip_but_no_other_name() -> None:
    proxied = Address(8097, "https://lab.example/runs")
    assert proxied.secure
    assert proxied.knows_host("Lab.example")
    assert proxied.knows_origin("https://lab.example")
    assert not proxied.knows_host("evil.example")
    assert not proxied.knows_host("192.0.2.1:8097")
    opened = Address(8097, open_to_all=True)
    assert opened.knows_host("192.0.2.1:8097")
    assert opened.knows_host("[2001:db8::1]:8097")
    assert not opened.knows_host("192.0.2.1:80")
    assert not opened.knows_host("evil.example:8097")


def test_off_loopback_only_when_told_to(tmp_path: Path) -> None:
    refused = run("glue-view", str(tmp_path), "--host", "0.0.0.0", cwd=tmp_path, status=2)
    assert "--insecure" in refused.stderr
