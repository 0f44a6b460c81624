"""Both directions with OpenEnv's own server and client."""

from __future__ import annotations

import asyncio
import json
import math
import re
import signal
import socket
import subprocess
import sys
import threading
import time
import urllib.error
import urllib.request
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path
from typing import Any, Literal

import gymnasium
import numpy as np
import pytest
import uvicorn
from click.testing import CliRunner
from gymnasium import spaces
from openenv.core.env_server.http_server import create_fastapi_app
from openenv.core.env_server.interfaces import Environment as OpenEnvironment
from openenv.core.env_server.types import Action as OpenAction
from openenv.core.env_server.types import Observation as OpenObservation
from openenv.core.env_server.types import State
from openenv.core.generic_client import GenericEnvClient
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect
from websockets.sync.server import ServerConnection
from websockets.sync.server import serve as serve_websockets

import glue
import glue.gym
from env_server.cli.environment import environment as glue_env
from env_server.mario.environment import InfiniteMario
from glue.errors import ConfigError, SimulatorError
from glue.gym.served import GymnasiumEnvironment
from glue.openenv.serving import _idle_bounded, application, serve
from glue.taskspec import parse_task_spec
from glue.types import Action, Step
from tests.pages import DOCS, follow
from tests.players import ScriptedEnvironment


class EchoAction(OpenAction):  # type: ignore[misc]
    message: str
    side: Literal["left", "right"] = "left"


class EchoObservation(OpenObservation):  # type: ignore[misc]
    echo: str
    side: Literal["left", "right"]
    steps: list[int]


class Echo(OpenEnvironment):  # type: ignore[misc]
    """Answers with the message; ends after three steps. A reward is the length of the message."""

    SUPPORTS_CONCURRENT_SESSIONS = True

    def __init__(self) -> None:
        super().__init__()
        self._state = State()

    def reset(self, seed: int | None = None, episode_id: str | None = None, greeting: str = "") -> Any:
        self._state = State(episode_id=episode_id, step_count=0)
        return EchoObservation(echo=f"{greeting}{seed}", side="left", steps=[])

    def step(self, action: Any, timeout_s: float | None = None) -> Any:
        if action.message == "raise":
            raise RuntimeError("as you wish\x1b[2J")
        self._state.step_count += 1
        steps = [*range(self._state.step_count)]
        over = len(steps) == 3
        return EchoObservation(
            echo=action.message, side=action.side, steps=steps, done=over, reward=len(action.message)
        )

    @property
    def state(self) -> State:
        return self._state


@contextmanager
def served(app: Any) -> Iterator[str]:
    """Run an application on a free port; yield its URL."""
    with socket.create_server(("127.0.0.1", 0)) as listening:
        server = uvicorn.Server(uvicorn.Config(app, log_level="critical", timeout_graceful_shutdown=1))
        thread = threading.Thread(target=server.run, args=([listening],))
        thread.start()
        try:
            yield f"http://127.0.0.1:{listening.getsockname()[1]}"
        finally:
            server.should_exit = True
            thread.join()


@pytest.fixture(scope="module")
def echo() -> Iterator[str]:
    with served(create_fastapi_app(Echo, EchoAction, EchoObservation, 4)) as url:
        yield url


@pytest.fixture(scope="module")
def mines() -> Iterator[str]:
    with served(application(lambda: glue.make("mines", masks=True), "mines")) as url:
        yield url


def text(message: str, size: int = 32) -> bytes:
    return message.encode().ljust(size, b"\0")


def step(env: glue.Environment, side: int, message: str) -> Step:
    result = env.env_step(Action([side], (), text(message)))
    assert isinstance(result, Step)
    return result


def test_openenv_server_is_an_environment_here(echo: str) -> None:
    env = glue.make(f"openenv:{echo}", max_text=32, reset='{"greeting": "hello "}')
    spec = parse_task_spec(env.env_init())
    assert (spec.observations.counts, spec.actions.counts) == ((1, 0, 64), (1, 0, 32))
    env.env_seed(7)  # type: ignore[attr-defined]
    assert env.env_start().chars == text("hello 7") + text("[]")
    first = step(env, 1, "ab")
    assert (first.reward, first.terminal, first.observation.ints.tolist()) == (2.0, False, [1])
    assert first.observation.chars == text("ab") + text("[0]")
    step(env, 0, "")
    assert step(env, 0, "abc").terminal
    with pytest.raises(SimulatorError, match="no episode"):
        step(env, 0, "")
    assert env.env_start().chars == text("hello None") + text("[]")
    env.env_cleanup()


def test_gymnasium_sees_the_fields_of_an_openenv_server(echo: str) -> None:
    env = glue.gym.wrap(glue.make(f"openenv:{echo}", max_text=32))
    observation, _ = env.reset(seed=3)
    assert set(observation) == {"echo", "side", "steps"}
    message = np.frombuffer(text("abc"), np.uint8)
    _, reward, *_ = env.step({"message": message, "side": np.int64(1)})
    assert reward == 3.0
    env.close()


def test_what_a_server_refuses_is_an_error_in_its_words(echo: str) -> None:
    env = glue.make(f"openenv:{echo}", max_text=8)
    env.env_init()
    env.env_start()
    with pytest.raises(SimulatorError, match="as you wish"):
        env.env_step(Action([0], (), text("raise", 8)))
    env.env_cleanup()
    small = glue.make(f"openenv:{echo}", max_text=2)
    small.env_init()
    with pytest.raises(
        SimulatorError, match="echo: a text of 4 bytes does not fit the 2 of the option max_text"
    ):
        small.env_start()
    small.env_cleanup()


def test_server_that_is_none_is_refused_in_one_line() -> None:
    with pytest.raises(ConfigError, match=r"no OpenEnv server answers at http://127\.0\.0\.1:1: "):
        glue.make("openenv:http://127.0.0.1:1")
    strange = ("http://[::1", "http://127.0.0.1:x", "http://a b", "http://127.0.0.1/\n")
    for url in ("127.0.0.1:8000", "file:///etc/passwd", "ws://127.0.0.1", *strange):
        with pytest.raises(ConfigError, match="named by its URL"):
            glue.make(f"openenv:{url}")


@pytest.mark.parametrize(
    ("body", "expected"),
    [
        (b"<html>", "is not the JSON"),
        (None, "no OpenEnv server answers at .*BadStatusLine"),
        (b"[" * 10**5, "is not the JSON"),
        (b" " * (2**20 + 1), "has sent more than"),
        (b"{}", "expected the JSON schema of an object"),
        (b'{"action": {"properties": {"a": {}}}, "observation": {"properties": {}}}', "no fields"),
    ],
)
def test_hostile_schema_is_refused_in_one_line(body: bytes | None, expected: str) -> None:
    class Answer(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            if body is None:  # a server of something else
                self.wfile.write(b"SSH-2.0\r\n")
                return
            self.send_response(200)
            self.end_headers()
            self.wfile.write(body)

        def log_message(self, *_: Any) -> None:
            pass

    with HTTPServer(("127.0.0.1", 0), Answer) as server:
        threading.Thread(target=server.handle_request).start()
        with pytest.raises(ConfigError, match=expected):
            glue.make(f"openenv:http://127.0.0.1:{server.server_address[1]}")


def test_schema_that_drips_is_not_waited_for() -> None:
    def drip(listening: socket.socket) -> None:
        connection, _ = listening.accept()
        with connection, suppress(OSError):
            connection.sendall(b"HTTP/1.1 200 OK\r\n\r\n")
            for _ in range(60):
                connection.sendall(b" ")
                time.sleep(0.05)

    with socket.create_server(("127.0.0.1", 0)) as listening:
        threading.Thread(target=drip, args=[listening], daemon=True).start()
        with pytest.raises(ConfigError, match=r"has not answered within 0\.2 s"):
            glue.make(f"openenv:http://127.0.0.1:{listening.getsockname()[1]}", timeout=0.2)


@contextmanager
def begun(echo: str, play: Callable[[ServerConnection], None], **options: float) -> Iterator[Any]:
    """Yield an environment in an episode of `play`, which takes the place of the server behind it."""
    env: Any = glue.make(f"openenv:{echo}", max_text=32, **options)
    with serve_websockets(play, "127.0.0.1", 0) as server:
        threading.Thread(target=server.serve_forever).start()
        env.url = f"http://127.0.0.1:{server.socket.getsockname()[1]}"
        env.env_init()
        env.env_start()
        yield env
        env.env_cleanup()


@pytest.mark.parametrize(
    ("answer", "expected"),
    [
        ({"reward": math.inf}, "a reward is a finite number, not inf"),
        ({"reward": math.nan}, "a reward is a finite number, not nan"),
        ({"reward": 10**400}, "a reward is a finite number, not 1000"),
        ({"done": "true"}, "done is true or false, not 'true'"),
        (None, "has not answered within 0.5 seconds, the option timeout"),
    ],
)
def test_answer_that_is_no_step_is_refused(answer: dict[str, Any] | None, expected: str, echo: str) -> None:
    def play(client: ServerConnection) -> None:
        for message in client:
            value = {"echo": "", "side": "left", "steps": []}
            data: dict[str, Any] = {"observation": value, "reward": 1.0, "done": False}
            if json.loads(message)["type"] == "step":
                if answer is None:
                    continue
                data |= answer
            client.send(json.dumps({"type": "observation", "data": data}))

    with begun(echo, play, timeout=50.0) as env:
        client = env._client.async_client
        assert client._message_timeout == 50.0
        if answer is None:  # it is waited for in vain; what came before may have taken longer
            env._timeout = client._message_timeout = 0.5
        with pytest.raises(SimulatorError, match=expected):
            step(env, 0, "")


def test_episode_is_not_continued_over_another_connection(echo: str) -> None:
    def play(client: ServerConnection) -> None:
        for _ in range(2):
            client.recv()
            value = {"echo": "", "side": "left", "steps": []}
            client.send(json.dumps({"type": "observation", "data": {"observation": value, "done": False}}))
        # Returning closes the connection.

    with begun(echo, play) as env:
        step(env, 0, "")
        with pytest.raises(SimulatorError, match="closed the connection in the middle of an episode"):
            step(env, 0, "")
        env.env_start()


def test_our_environment_plays_with_openenvs_client_as_it_plays_here(mines: str) -> None:
    here = glue.gym.wrap(glue.make("mines", masks=True))
    chance = np.random.default_rng(5)
    with GenericEnvClient(mines).sync() as client:
        for seed in range(3):
            assert client.reset(seed=seed).observation["observation"] == here.reset(seed=seed)[0]
            for move in chance.integers(4, size=200).tolist():
                there, (shown, reward, over, _, info) = client.step({"action": move}), here.step(move)
                assert (there.observation["observation"], there.reward, there.done) == (shown, reward, over)
                assert there.metadata == {"action_mask": info["action_mask"].tolist()}
                if over:
                    break
        assert client.state()["step_count"] > 0
        with pytest.raises(RuntimeError, match="VALIDATION_ERROR"):
            client.step({"action": 4})
        with pytest.raises(RuntimeError, match="a seed is a whole number, not 'x'"):
            client.reset(seed="x")
    here.close()


def test_episode_that_is_cut_off_is_done_and_says_so() -> None:
    environment = ScriptedEnvironment(length=1)
    environment.cuts = True
    environment.task_spec = (
        "VERSION RL-Glue-3.0 PROBLEMTYPE episodic DISCOUNTFACTOR 1 OBSERVATIONS INTS (0 9) "
        "ACTIONS INTS (0 2) (0 1) REWARDS (0 1) EXTRA masks"
    )
    with served(application(lambda: environment, "cut")) as url, GenericEnvClient(url).sync() as client:
        every = {"action_mask": [[1, 1, 1], [1, 1]]}
        assert client.reset().metadata == every
        result = client.step({"action": [0, 0]})
        assert (result.done, result.metadata) == (True, {"truncated": True, **every})


def test_the_server_states_its_name_and_what_an_action_is(mines: str) -> None:
    with urllib.request.urlopen(f"{mines}/metadata") as answer:
        assert json.load(answer)["name"] == "mines"
    with urllib.request.urlopen(f"{mines}/schema") as answer:
        action = json.load(answer)["action"]["properties"]["action"]
    assert (action["minimum"], action["maximum"]) == (0, 3)


def test_mario_is_typed_and_comes_back_to_us_through_openenv() -> None:
    with served(application(lambda: glue.make("mario"), "mario")) as url:
        with GenericEnvClient(url).sync() as client:
            shown = client.reset(seed=1).observation
            assert len(shown["chars"]) == 16 * 22
            assert "M" in shown["chars"]
            assert {type(one) for one in shown["ints"]} <= {int}
            assert client.step({"action": [1, 0, 1]}).observation["chars"] != ""
        again = glue.make(f"openenv:{url}")
        assert parse_task_spec(again.env_init()).actions.counts == (3, 0, 0)
        again.env_start()
        assert again.env_step(Action([1, 0, 1]))[2] is False
        again.env_cleanup()


class Named(gymnasium.Env[Any, Any]):  # type: ignore[misc]
    """Its observations and actions are dicts of one name each."""

    def __init__(self, seen: str, done: str) -> None:
        self.observation_space = spaces.Dict({seen: spaces.Discrete(3)})
        self.action_space = spaces.Dict({done: spaces.Discrete(3)})


@pytest.mark.parametrize(
    ("seen", "done"),
    [("reward", "a"), ("done", "a"), ("_a", "a"), ("a", "metadata"), ("a", "model_config")],
)
def test_name_that_openenv_does_not_allow_is_refused(seen: str, done: str) -> None:
    with pytest.raises(ConfigError, match=f"cannot send a Dict of {seen if done == 'a' else done}"):
        application(lambda: GymnasiumEnvironment(lambda: Named(seen, done)), "named")
    application(lambda: GymnasiumEnvironment(lambda: Named("a", "reward")), "named")


def test_idle_connection_is_closed_and_a_thinking_one_is_not() -> None:
    made: list[glue.Environment] = []
    ended = threading.Event()

    def make() -> glue.Environment:
        environment = glue.make("mines")
        cleanup = environment.env_cleanup
        environment.env_cleanup = lambda: (cleanup(), ended.set())  # type: ignore[assignment,method-assign,func-returns-value]
        made.append(environment)
        return environment

    app = application(make, "mines", idle=0.2)
    ended.clear()
    with served(app) as url, GenericEnvClient(url).sync() as thinking:
        thinking.reset(seed=1)
        with GenericEnvClient(url).sync() as idle:
            idle.connect()
            assert ended.wait(60)  # The idle one, as the other is in an episode for longer.
        assert thinking.step({"action": 0}).done is False
        assert thinking.state()["step_count"] == 1


def test_the_page_is_true(tmp_path: Path) -> None:
    text = (DOCS / "openenv.md").read_text("utf-8")
    (port,) = {"8000"} & set(re.findall(r"127\.0\.0\.1:(\d+)", text))
    with served(application(lambda: glue.make("mario"), "mario")) as url:
        own = text.replace(f"127.0.0.1:{port}", url.removeprefix("http://"))
        assert re.search(r"^return -?[0-9.]+$", follow(own, tmp_path, "client"), re.MULTILINE)
        follow(own, tmp_path, "here")


def test_command_serves_until_it_is_interrupted() -> None:
    options = ["--masks", "--check-actions", "--openenv", "127.0.0.1:0"]
    command = [sys.executable, "-m", "glue_rl", "environment", "mines", *options]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as process:
        assert process.stderr is not None
        (url,) = next(found for line in process.stderr if (found := re.findall(r"http://\S+", line)))
        try:
            with GenericEnvClient(url).sync() as client:
                mask = client.reset(seed=1).metadata["action_mask"]
                with pytest.raises(RuntimeError, match="is illegal"):
                    client.step({"action": mask.index(0)})
        finally:
            process.send_signal(signal.SIGINT)
        assert process.wait(60) == 130


def test_command_prints_a_level_instead_of_serving() -> None:
    options = ["mario", "--openenv", "127.0.0.1:0", "--level-width", "0", "--level-template", "0"]
    done = CliRunner().invoke(glue_env, options, catch_exceptions=False)
    assert (done.exit_code, done.stdout) == (0, InfiniteMario(level_width=0).level_template(0))


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        (["--openenv", "127.0.0.1:0", "--render"], "leave out --render"),
        (["--openenv", "127.0.0.1:0", "--hub-key", "hub.pub"], "leave out --hub-key"),
        (["--insecure"], "--insecure is for --openenv"),
    ],
)
def test_option_that_would_have_no_effect_is_refused(options: list[str], expected: str) -> None:
    with pytest.raises(ConfigError, match=expected):
        CliRunner().invoke(glue_env, ["mines", *options], catch_exceptions=False)


def test_page_of_another_site_cannot_play(mines: str) -> None:
    strange = ({"Host": "["}, {"Origin": "http://["})
    for headers in ({"Origin": "http://example.org"}, {"Host": "example.org"}, *strange):
        with pytest.raises(urllib.error.HTTPError, match="403"):
            urllib.request.urlopen(urllib.request.Request(f"{mines}/schema", headers=headers))
    with pytest.raises(InvalidStatus, match="403"):
        connect(f"{mines.replace('http', 'ws')}/ws", origin="http://example.org")


def test_client_that_leaves_before_its_answer_is_no_error() -> None:
    async def gone(_: Any = None) -> Any:
        raise OSError

    async def answer() -> None:
        _, send = _idle_bounded(gone, gone, 1.0)
        await send({"type": "websocket.send", "text": '{"type": "state"}'})

    asyncio.run(answer())


@pytest.mark.parametrize(
    ("path", "body", "status"),
    [("/mcp", b"{}", "404"), ("/step", b"{}", "404"), ("/reset", b" " * (2**20 + 1), "400")],
)
def test_request_that_is_not_served_is_refused(path: str, body: bytes, status: str, mines: str) -> None:
    headers = {"Content-Type": "application/json"}
    with pytest.raises(urllib.error.HTTPError, match=status):
        urllib.request.urlopen(urllib.request.Request(mines + path, body, headers))


@pytest.mark.parametrize(
    ("address", "expected"),
    [("8000", "is HOST:PORT"), ("0.0.0.0:8000", "other machines"), ("127.0.0.1:99999", "is HOST:PORT")],
)
def test_address_that_cannot_be_served_is_refused(address: str, expected: str) -> None:
    with pytest.raises(ConfigError, match=re.escape(expected)):
        serve(lambda: glue.make("mines"), "mines", address)
