"""A model behind a local endpoint: how it plays, what is recorded, and endpoints that nobody can trust."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext, suppress
from hashlib import sha256
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from itertools import chain, repeat
from pathlib import Path
from threading import Event, Thread
from typing import Any

import pytest

from agents.language import chat
from agents.language.chat import Endpoint, EndpointFailed, read_choice, read_reply
from env_server.toys import MinesEnvironment, SkeletonEnvironment
from glue import ConfigError, GlueError, Observation, check_agent, local, make_agent
from glue.trajectory import TrajectoryReader
from tests import forked

Handler = BaseHTTPRequestHandler
Reply = Callable[[dict[str, Any], Handler], object]
"""Gets the request's JSON. Returns an answer for JSON, bytes, or None if it has written one itself."""


def said(text: str | None, tokens: tuple[int, int] = (10, 4)) -> dict[str, Any]:
    """Return the answer of an endpoint whose model says `text`."""
    usage = dict(zip(("prompt_tokens", "completion_tokens"), tokens, strict=True))
    return {"choices": [{"message": {"role": "assistant", "content": text}}], "usage": usage}


@contextmanager
def endpoint(reply: Reply) -> Iterator[str]:
    """Yield the address of an endpoint that answers by `reply`."""

    class Answering(Handler):
        def do_POST(self) -> None:
            body = json.loads(self.rfile.read(int(self.headers["Content-Length"])))
            answer = reply(body, self)
            if answer is None:
                return
            data = answer if isinstance(answer, bytes) else json.dumps(answer).encode()
            self.send_response(200)
            self.send_header("Content-Length", str(len(data)))
            self.end_headers()
            self.wfile.write(data)

        def log_message(self, format: str, *args: object) -> None:
            pass

    server = ThreadingHTTPServer(("127.0.0.1", 0), Answering)
    server.daemon_threads = True
    thread = Thread(target=server.serve_forever, kwargs={"poll_interval": 0.02})
    thread.start()
    try:
        yield f"http://127.0.0.1:{server.server_port}/v1"
    finally:
        server.shutdown()
        thread.join()
        server.server_close()


SECRET = "sk-do/not+show"


def model(*answers: str) -> Reply:
    """Return an endpoint's reply that says these answers, then the last one for ever."""
    texts = chain(answers, repeat(answers[-1]))
    return lambda body, handler: said(next(texts))


@pytest.fixture(autouse=True)
def _at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(chat, "_WAITS", (0.0, 0.0))


@pytest.mark.parametrize(
    ("text", "choice"),
    [
        ("act: right", (["right"], "end")),
        ("I go left.\nact: left\nNo:\n Act: up, down*3 until reward", (["up", "down*3"], "reward")),
        ("**ACT:** .5 0 1, `stay`, stay*2.\n", ([".5 0 1", "stay", "stay*2"], "end")),
        ("act: right UNTIL never", (["right"], "never")),
        ("ACT: RIGHT UNTIL reward", (["RIGHT"], "reward")),
        ("act: right*5, until reward", (["right*5"], "reward")),
        ("**act: right,up** until **Reward**.", (["right", "up"], "reward")),
        ("- act: -1 0 1, right", (["-1 0 1", "right"], "end")),
        ("act: right until never", (["right"], "never")),
        ("I am stuck.\nGive up.", ([], "end")),
        ("act:", ([""], "end")),
        ("I act: right", (None, "end")),
    ],
)
def test_a_choice_is_the_last_line_that_states_one(text: str, choice: tuple[object, str]) -> None:
    assert read_choice(text) == choice


def test_a_model_plays_with_the_rules_its_history_and_its_sampling() -> None:
    asked: list[dict[str, Any]] = []

    def reply(body: dict[str, Any], handler: Handler) -> object:
        asked.append(body)
        assert handler.path == "/v1/chat/completions"
        return said(["What now?", "act: right*5", "act: right*5"][len(asked) - 1])

    with endpoint(reply) as url:
        agent = make_agent("chat", url=url, model="ours", temperature=0.5, memory=1)
        with local(agent, SkeletonEnvironment()) as glue:
            glue.rl_init(seed=1)
            assert glue.rl_episode()
            assert glue.rl_return() == 1.0
            record = json.loads(glue.rl_agent_message("record"))
            newest = json.loads(glue.rl_agent_message("answers"))
            assert "record and answers" in glue.rl_agent_message("who are you?")
    first, second, third = asked
    assert (first["model"], first["temperature"], first["max_tokens"]) == ("ours", 0.5, 1024)
    assert "top_p" not in first
    assert [message["role"] for message in first["messages"]] == ["system", "user"]
    assert "The left end pays -1" in first["messages"][0]["content"]
    assert "Turn 1." in first["messages"][1]["content"]
    illegal = second["messages"][-1]["content"]
    assert illegal.startswith("Illegal: no list of actions was given")
    assert "Turn 2." in illegal
    assert illegal.count("@") == 1
    assert len(third["messages"]) == 4  # the rules, one earlier choice and its answer, and the question
    counts = {"choices": 3, "illegal": 1, "repeated": 0, "forfeits": 0, "tokens_in": 30, "tokens_out": 12}
    assert record["counts"].items() > counts.items()
    assert agent.agent_metrics() == record["counts"]  # type: ignore[attr-defined]
    assert record["settings"].items() > {"url": url, "model": "ours", "temperature": 0.5}.items()
    assert record["prompt"] == sha256(first["messages"][0]["content"].encode()).hexdigest()
    assert [answer["answer"] for answer in record["answers"]] == ["What now?", "act: right*5", "act: right*5"]
    assert newest == [{"turn": 3, "answer": "act: right*5"}]


def test_it_keeps_the_contract_of_agents() -> None:
    with endpoint(model("act: left*2")) as url:
        check_agent(
            lambda: make_agent("chat", url=url, model="m"), MinesEnvironment().env_init(), episodes=1, steps=5
        )


@pytest.mark.parametrize(("answer", "illegal"), [("act: fly", 3), ("give up", 0)])
def test_a_model_that_gives_up_or_chooses_nothing_legal_forfeits(answer: str, illegal: int) -> None:
    with (
        endpoint(model(answer)) as url,
        local(make_agent("chat", url=url, model="m", illegal=3), MinesEnvironment()) as glue,
    ):
        glue.rl_init()
        for _ in range(2):
            assert not glue.rl_episode(50)
            assert glue.rl_return() == -49.0  # it stands still, by walking into the wall
            assert glue.rl_agent_metrics().items() > {"illegal": illegal, "forfeits": 1}.items()


def test_an_endpoint_without_time_left_forfeits_the_episode() -> None:
    asked = Event()
    with endpoint(lambda body, handler: asked.wait(30) and None) as url:
        agent = make_agent("chat", url=url, model="m", seconds=0.2)
        agent.agent_init(SkeletonEnvironment().env_init())
        assert agent.agent_start(Observation([10])).ints.tolist() == [0]
        asked.set()
    counts = json.loads(agent.agent_message("record"))["counts"]
    assert (counts["forfeits"], counts["repeated"]) == (1, 0)
    assert counts["seconds"] >= 0.2


def test_every_episode_is_verified_by_replay_of_its_actions(tmp_path: Path) -> None:
    """The model cannot be run again; its actions can, and its raw answers are with them."""
    with endpoint(model("Let me see.\nact: right*4, up", "act: fly", "act: down*2")) as url:
        run = forked.run(
            *("glue-experiment", "--env", "mines", "--agent", "chat", "--episodes", "2", "--max-steps", "12"),
            *("--agent-option", f"url={url}", "--agent-option", "model=ours", "--in-process", "--seed", "1"),
            *("--record", "run.traj", "--ask", "record", "--ask", "answers", "--out", "run"),
            cwd=tmp_path,
        )
    assert run.returncode == 0, run.stderr
    assert forked.run("glue-replay", "--check", "run.traj", cwd=tmp_path).returncode == 0
    episode, _ = TrajectoryReader(tmp_path / "run.traj")
    assert [step.action.ints.tolist() for step in episode.steps[:6]] == [[3]] * 4 + [[0], [1]]
    assert url in forked.run("glue-results", "show", "run", "--json", cwd=tmp_path).stdout


def raw(data: bytes) -> Reply:
    """Return a reply that writes these bytes instead of an answer, and closes the connection."""

    def reply(body: dict[str, Any], handler: Handler) -> None:
        handler.close_connection = True
        handler.wfile.write(data)

    return reply


def dripping(body: dict[str, Any], handler: Handler) -> None:
    """Send a byte of a header now and then, until nobody listens."""
    handler.close_connection = True
    with suppress(OSError):
        handler.wfile.write(b"HTTP/1.1 200 OK\r\n")
        while True:
            handler.wfile.write(b"X")
            time.sleep(0.05)


def status(code: int, text: str = "", **headers: str) -> Reply:
    lines = [f"HTTP/1.1 {code} Told", *(f"{name}: {value}" for name, value in headers.items())]
    return raw("\r\n".join([*lines, "", text]).encode())


def echo(code: int) -> Reply:
    """Return a reply that repeats the key, escaped as some libraries write JSON."""

    def reply(body: dict[str, Any], handler: Handler) -> object:
        key = handler.headers.get("Authorization", "").replace("/", "\\/")
        return status(code, f'{{"error": "unknown: {key}"}}')(body, handler)

    return reply


BUSY: list[tuple[Reply, str]] = [
    (dripping, "has not answered within 0.3 s"),
    (raw(b""), "cannot be asked"),
    (raw(b"220 mail.example ESMTP\r\n"), "cannot be asked"),
    (raw(b"HTTP/1.1 200 OK\r\n" + b"X: y\r\n" * 1000), "cannot be asked"),
    (status(429, "slow down"), "answered 429: slow down"),
    (status(503, "\x1b[2J"), r"answered 503: \?\[2J"),
    (echo(503), r"unknown: Bearer \(the key\)"),
]
FAILED: list[tuple[Reply, str]] = [
    (lambda body, handler: b" " * 2**21, "has sent more than 1,048,576 bytes"),
    (status(200, "x", **{"Content-Length": "99999999999"}), "cannot be asked|not with JSON"),
    (status(302, Location="http://192.0.2.1/"), "a redirection to http://192.0.2.1/, which is not followed"),
    (status(401, "who are you?"), "answered 401: who are you?"),
    (echo(401), r'answered 401: {"error": "unknown: Bearer \(the key\)"}'),
    (echo(200), r"no text at .*unknown: Bearer \(the key\)"),
    (lambda body, handler: b"<html>", "answered 200, not with JSON: <html>"),
    (lambda body, handler: b"[" * 200_000, "not with JSON"),
    (lambda body, handler: {"error": {"message": "no such model"}}, "no text at .*no such model"),
]


@pytest.mark.parametrize(
    ("reply", "message"), [*BUSY, *FAILED], ids=lambda value: value if isinstance(value, str) else ""
)
def test_an_endpoint_that_nobody_can_trust_is_bounded_and_told_in_words(reply: Reply, message: str) -> None:
    with endpoint(reply) as url, pytest.raises(EndpointFailed, match=message) as failure:
        Endpoint(url, SECRET).post({"model": "m"}, 0.3 if reply is dripping else 20.0)
    assert SECRET not in str(failure.value)
    assert len(str(failure.value)) < 500
    with pytest.raises(EndpointFailed, match="cannot be asked: Connection refused"):
        Endpoint(url).post({}, 20.0)


@pytest.mark.parametrize(("busy", "error"), [(2, None), (9, "503"), (0, "400")])
def test_another_try_is_made_where_it_may_help(busy: int, error: str | None) -> None:
    replies = iter([*[status(503)] * busy, model("act: left*20") if error is None else status(400)])
    with endpoint(lambda body, handler: next(replies)(body, handler)) as url:
        agent = make_agent("chat", url=url, model="m")
        refused = pytest.raises(GlueError, match=f"{url}/chat/completions answered {error}")
        with local(agent, SkeletonEnvironment()) as glue, refused if error else nullcontext():
            glue.rl_init()
            glue.rl_episode()
    assert json.loads(agent.agent_message("record"))["counts"]["repeated"] == min(busy, 2)
    assert len(list(replies)) == max(0, busy + 1 - 3)


@pytest.mark.parametrize("path", ["", "/", "/chat/completions", "/chat/completions/"])
def test_an_endpoint_is_given_by_its_base_or_its_whole_address(path: str) -> None:
    def reply(body: dict[str, Any], handler: Handler) -> object:
        return said(handler.path)

    with endpoint(reply) as url:
        assert Endpoint(f"{url}{path}").post({}, 20.0).text == "/v1/chat/completions"


@pytest.mark.parametrize(
    "url",
    [
        *("", "example", "ftp://127.0.0.1/", "http://", "http://u:p@127.0.0.1/", "http://127.0.0.1/?key=1"),
        *("http://[1/", "http://127.0.0.1:99999/v1", "http://127.0.0.1/\r\nX: y", "file:///etc/passwd"),
    ],
)
def test_what_is_no_address_of_an_endpoint_is_refused(url: str) -> None:
    with pytest.raises(ConfigError) as refusal:
        make_agent("chat", url=url, model="m")
    assert refusal.value.settings[0] == "url"


@pytest.mark.parametrize("odd", [-1, 12.0, "7", True, 2**31, None, [3]])
def test_what_is_no_number_of_tokens_counts_as_none(odd: Any) -> None:
    assert read_reply(said("act: up", (odd, 4))) == ("act: up", 0, 4)
    assert read_reply(said("act: up") | {"usage": odd}) == ("act: up", 0, 0)


def test_a_key_is_sent_to_its_endpoint_and_shown_nowhere(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("GLUE_CHAT_KEY", SECRET)
    sent: list[str | None] = []

    def reply(body: dict[str, Any], handler: Handler) -> object:
        sent.append(handler.headers["Authorization"])
        assert SECRET not in json.dumps(body)
        return said("act: left*20")

    with endpoint(reply) as url, local(make_agent("chat", url=url, model="m"), SkeletonEnvironment()) as glue:
        glue.rl_init()
        glue.rl_episode()
        assert SECRET not in glue.rl_agent_message("record")
    assert sent == [f"Bearer {SECRET}"]
    for unbounded in ("timeout", "seconds", "temperature"):
        with pytest.raises(ConfigError, match=f"option {unbounded} must be from .* not inf"):
            make_agent("chat", url="http://127.0.0.1/v1", model="m", **{unbounded: math.inf})
    for key, says in ((SECRET, "in clear text"), (f"{SECRET}\n", "not a key"), (f"{SECRET}ß", "not a key")):
        with pytest.raises(ConfigError, match=says) as refusal:
            Endpoint("http://192.0.2.1/v1" if key == SECRET else "https://192.0.2.1/v1", key)
        assert SECRET not in str(refusal.value)
