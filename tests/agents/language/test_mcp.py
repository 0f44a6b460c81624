"""The server of the Model Context Protocol and the SDK's own client: in memory, over HTTP and over stdio."""

from __future__ import annotations

import math
import os
import sys
from collections.abc import Awaitable, Callable
from http.client import HTTPConnection
from pathlib import Path
from subprocess import PIPE, Popen
from threading import Barrier
from typing import Any

import anyio
import pytest

from agents.language import server
from agents.language.game import Answer
from agents.language.server import MCPAgent, make_server
from env_server.toys import MinesEnvironment
from glue.errors import ConfigError
from tests import forked
from tests.agents.language.test_calls import session
from tests.agents.language.test_texts import MARIO_SEEN
from tests.agents.screens import TASK_SPEC
from tests.pages import DOCS, follow

mcp = pytest.importorskip("mcp", reason="needs the SDK: pip install 'glue-rl[mcp]'")

AGENT = str(Path(sys.executable).parent / "glue-agent")
MODES = ["auto", "legacy"]
WITH_SDK = "runs in the tests, where the SDK is installed"


@pytest.fixture(autouse=True)
def _first(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the first agent of each test be that of a process which a client has started."""
    monkeypatch.setattr(server, "_NEWEST", {})
    monkeypatch.setattr(server, "_has_client", lambda: True)


def talk(where: object, mode: str, *steps: Callable[[Any], Awaitable[None]]) -> None:
    """Let a client take these steps, each over a connection of its own."""

    async def run() -> None:
        for step in steps:
            async with mcp.Client(where() if callable(where) else where, mode=mode) as client:
                await step(client)

    anyio.run(run)


async def call(client: Any, tool: str, **arguments: object) -> Any:
    return await client.call_tool(tool, arguments)


async def first_part(client: Any) -> None:
    tools = (await client.list_tools()).tools
    assert [tool.name for tool in tools] == ["look", "act", "give_up"]  # none resets
    look = await call(client, "look")
    assert "You are @ on a grid" in look.content[0].text
    illegal = await call(client, "act", turn=1, actions=["fly"])
    assert illegal.is_error
    assert "legal are: up, down, left, right" in illegal.content[0].text
    played = await call(client, "act", turn=2, actions=["right*3", "down"], until="end")
    assert played.structured_content.items() > {"turn": 3, "reward": -4.0, "steps": 4, "over": False}.items()


async def second_part(client: Any) -> None:
    """A new connection goes on where the last one was."""
    assert "You are @ on a grid" in client.instructions
    again = await call(client, "act", turn=2, actions=["right*3", "down"], until="end")
    assert again.structured_content["turn"] == 3
    old = await call(client, "act", turn=1, actions=["up"])
    assert old.is_error
    assert "the current turn is 3" in old.content[0].text
    assert "You are @" not in (await call(client, "look")).content[0].text
    given = await call(client, "give_up", turn=3)
    assert given.structured_content.items() > {"over": True, "forfeit": True}.items()


async def last_part(client: Any) -> None:
    for tool, arguments in (("look", {}), ("act", {"turn": 4, "actions": ["up"]}), ("reset", {})):
        with pytest.raises(mcp.MCPError):
            await call(client, tool, **arguments)


@pytest.mark.parametrize("mode", MODES)
def test_over_http_but_not_through_a_page_of_another_site(
    mode: str, caplog: pytest.LogCaptureFixture
) -> None:
    agent = MCPAgent(port=0)
    (url,) = (line.rpartition(" ")[2] for line in caplog.messages if "http://127.0.0.1:" in line)
    with session(agent, MinesEnvironment()):
        talk(url, mode, first_part, second_part)
    agent.game.close()
    talk(url, mode, last_part)
    port = int(url.split(":")[2].partition("/")[0])
    with pytest.raises(ConfigError, match="cannot serve at port"):
        MCPAgent(port=port)
    for name, value in (("Origin", "http://192.0.2.1"), ("Host", "rebound.example")):
        connection = HTTPConnection("127.0.0.1", port)
        connection.request("POST", "/mcp", "{}", {"Content-Type": "application/json", name: value})
        assert connection.getresponse().status in (403, 421)
        connection.close()


def test_sessions_at_any_port_have_servers_of_their_own_but_those_in_turn_share_one(
    caplog: pytest.LogCaptureFixture,
) -> None:
    def urls() -> list[str]:
        return [line.rpartition(" ")[2] for line in caplog.messages if line.startswith("serving")]

    async def give_up(client: Any) -> None:
        while not (turn := (await call(client, "look")).structured_content["turn"]):
            pass
        given = await call(client, "give_up", turn=turn)
        assert given.structured_content.items() >= {"turn": 2, "episode": 1}.items()

    agents = MCPAgent(port=0), MCPAgent(port=0)
    with session(agents[0], MinesEnvironment()), session(agents[1], MinesEnvironment()):
        for url in urls():
            talk(url, "auto", give_up)
    MCPAgent(port=0)
    assert len({*urls()}) == len(urls()) == 2


async def look_to_the_end(client: Any) -> None:
    while True:
        await call(client, "look")


@pytest.mark.parametrize("mode", MODES)
def test_over_stdio_from_the_first_call_to_the_last(mode: str, tmp_path: Path) -> None:
    """It answers before there is a hub, plays a recorded experiment, and says in the end that it is over."""
    hub = f"ipc://{tmp_path}/hub"
    command = mcp.StdioServerParameters(command=AGENT, args=["mcp", "--hub", hub], env=dict(os.environ))
    run = ["glue-experiment", "--env", "mines", "--episodes", "1", "--max-steps", "30", "--bind", hub]
    run += ["--record", "run.traj", "--ask", "record"]
    started: list[forked.Forked] = []

    async def whole(client: Any) -> None:
        assert "has not begun" in (await call(client, "look")).content[0].text
        started.append(forked.start(*run, cwd=tmp_path, printed=[tmp_path / name for name in ("out", "err")]))
        while not (await call(client, "look")).structured_content["turn"]:
            pass
        played = await call(client, "act", turn=1, actions=["right*4", "down"])
        assert played.structured_content["steps"] == 5
        assert (await call(client, "give_up", turn=2)).structured_content["over"]
        assert started[0].wait(60) == 0
        with pytest.raises(mcp.MCPError, match="the session has ended"):
            await look_to_the_end(client)

    talk(lambda: mcp.stdio_client(command), mode, whole)
    assert forked.run("glue-replay", "--check", "run.traj", cwd=tmp_path).returncode == 0


def test_a_signal_ends_it_while_its_client_stays(tmp_path: Path) -> None:
    command = [AGENT, "mcp", "--hub", f"ipc://{tmp_path}/hub"]
    with Popen(command, stdin=PIPE, stdout=PIPE, stderr=PIPE) as agent:
        assert agent.stderr is not None
        assert b"waiting for one" in agent.stderr.readline()
        agent.terminate()
        assert agent.wait(60) == 143


def test_many_calls_wait_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    together = Barrier(60, timeout=60)

    def wait(agent: object, tool: str, arguments: object) -> Answer:
        together.wait()
        return Answer("", {})

    monkeypatch.setattr(MCPAgent, "_serve_stdio", lambda self: None)
    monkeypatch.setattr(server, "play", wait)

    async def looks(client: Any) -> None:
        async with anyio.create_task_group() as tasks:
            for _ in range(60):
                tasks.start_soon(call, client, "look")

    talk(make_server(MCPAgent()), "auto", looks)
    assert not together.broken


def test_mario_is_shown_as_an_image_on_request(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(MCPAgent, "_serve_stdio", lambda self: None)
    agent = MCPAgent()
    agent.game.task(TASK_SPEC)
    agent.game.start(MARIO_SEEN)

    async def looks(client: Any) -> None:
        assert len((await call(client, "look")).content) == 1
        text, image = (await call(client, "look", image=True)).content
        assert "mm Mario" in text.text
        assert (image.mime_type, image.data[:4]) == ("image/png", "iVBO")

    talk(make_server(agent), "auto", looks)


@pytest.mark.parametrize("reward", [math.nan, math.inf])
def test_a_reward_that_json_lacks_is_null(monkeypatch: pytest.MonkeyPatch, reward: float) -> None:
    monkeypatch.setattr(MCPAgent, "_serve_stdio", lambda self: None)
    agent = MCPAgent()
    agent.game.task(TASK_SPEC)
    agent.game.start(MARIO_SEEN)
    agent.game.step(reward, MARIO_SEEN)

    async def looks(client: Any) -> None:
        await client.list_tools()  # and with them the schemas, which the client checks from now on
        assert (await call(client, "look")).structured_content["return"] is None

    for mode in MODES:
        talk(make_server(agent), mode, looks)


def test_the_page_can_be_followed(tmp_path: Path) -> None:
    printed = follow((DOCS / "language-models.md").read_text("utf-8"), tmp_path, WITH_SDK)
    assert printed.startswith("1.0\n")
