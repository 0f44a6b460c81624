"""A language model as the client of a server of the Model Context Protocol, over stdio or HTTP.

The server runs in its own thread, so that it answers while the agent waits for the hub or for a step.
What it remembers is the game, not a client's session: a client that comes again continues where it was.
A process has one server at an address, for agents in turn, as each trial has its own.
"""

from __future__ import annotations

import asyncio
import atexit
import json
import os
import signal
import socket
import stat
import threading
from base64 import b64encode
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from importlib.util import find_spec
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Final

from agents.language.game import UNTIL, Answer, GameOptions, GameOver, LanguageAgent, NotNow, Phase, Until
from glue import __version__
from glue.console import LOG
from glue.errors import ConfigError, GlueError
from glue.options import Option, Value

if TYPE_CHECKING:
    from mcp.server.lowlevel import Server

_HOST: Final = "127.0.0.1"
_PATIENCE: Final = 3.0
"""Seconds for which a call waits for the game; then it is answered all the same."""

_GRACE: Final = 2.0
"""Seconds for which the last answers may arrive, over HTTP or after a signal."""

_MOST_CALLS: Final = 500
"""Calls that wait at once, each in a thread; more than these wait for one of them."""

_HOW: Final = """Call look first, and in each new episode. act takes a choice for the current turn, and waits
until it has been played; a call that was lost is repeated as it was. give_up ends the episode with what
standing still earns. Nothing resets the game: the experiment begins each episode."""

_TRUTH: Final = {"type": "boolean"}
_WHOLE: Final = {"type": "integer"}
_MAYBE: Final = {"type": ["number", "null"]}
_TEXTS: Final = {"type": "array", "items": {"type": "string"}}
_UNTIL: Final = {"type": "string", "enum": [*Until], "description": f"when the actions stop early: {UNTIL}"}
_TOOLS: Final[Mapping[str, tuple[str, dict[str, Any]]]] = {
    "look": ("Show what you see and the current turn, first with the rules.", {"image": _TRUTH}),
    "act": ("Take actions, by name.", {"turn": _WHOLE, "actions": _TEXTS, "until": _UNTIL}),
    "give_up": ("Forfeit the episode.", {"turn": _WHOLE}),
}
"""The tools, with what each does and takes."""

_ANSWER: Final = {
    **dict.fromkeys(("turn", "episode", "steps"), _WHOLE),
    **dict.fromkeys(("over", "forfeit"), _TRUTH),
    **dict.fromkeys(("reward", "return", "steps_left", "time_left"), _MAYBE),
    "legal": _TEXTS,
}


@dataclass(kw_only=True)
class Options(GameOptions):
    """The options of the agent `mcp`."""

    port: Annotated[int | None, Option(f"HTTP at {_HOST}, not stdio; 0 for any", low=0, high=65535)] = None
    model: Annotated[str, Option("name of the model that will play, for the record")] = ""


class MCPAgent(LanguageAgent):
    """A language model behind a client of the Model Context Protocol.

    Its tools are look, act and give_up. It serves the program that has started it, by standard input and
    output, or with --port any on this machine, by HTTP. docs/language-models.md shows both.
    """

    Options: ClassVar[type] = Options

    def __init__(self, **options: Value | None) -> None:
        made = Options(**options)  # type: ignore[arg-type]  # checked by `glue.options.build`
        port = made.port
        former = _NEWEST.get(port)
        if port == 0 and former is not None and not former.ended:
            former = None  # Any free port is another one than that of a session that may be played.
        if find_spec("mcp") is None or find_spec("mcp_types") is None:
            raise ConfigError(
                "the agent mcp needs version 2 of the protocol's SDK: pip install 'glue-rl[mcp]'"
            )
        if former is None and port is None and not _has_client():
            raise ConfigError(
                "standard input does not come from a client: give mcp a port, or let the client start "
                "glue-agent mcp",
                settings=("port",),
            )
        super().__init__(made, former)
        self.ended: bool = False
        """Whether its session has ended, so that another one may be played at any free port."""
        self.instructed: list[Any] = [] if former is None else former.instructed
        """Objects of the SDK whose `instructions` a client is shown; guarded by `changed`."""
        if former is None:
            serve = self._serve_stdio if port is None else partial(self._serve_http, _listen(port))
            self._thread = threading.Thread(target=serve, daemon=True)
            self._thread.start()
            atexit.register(self._leave)
        _NEWEST[port] = self

    @property
    def how(self) -> str:
        return _HOW

    def agent_init(self, task_spec: str) -> None:
        super().agent_init(task_spec)
        with self.changed:
            self.ended = False
            for instructed in self.instructed:
                instructed.instructions = self.prompt

    def agent_cleanup(self) -> None:
        super().agent_cleanup()
        self.ended = True

    def choose(self) -> None:
        self.changed.wait(min(self.game.time_left, 3600.0))

    def _serve_stdio(self) -> None:
        from mcp.server.stdio import stdio_server

        async def serve() -> None:
            server = make_server(self)
            async with stdio_server() as (read, write):
                with self.changed:
                    options = server.create_initialization_options()
                    self.instructed.append(options)
                await server.run(read, write, options)

        asyncio.run(serve())
        if threading.main_thread().is_alive():
            LOG.info("the client has closed standard input: leaving")
            os.kill(os.getpid(), signal.SIGTERM)

    def _serve_http(self, listening: socket.socket) -> None:
        import uvicorn

        app = make_server(self).streamable_http_app(host=_HOST, stateless_http=True, json_response=True)
        config = uvicorn.Config(app, log_config=None, access_log=False)
        asyncio.run(uvicorn.Server(config).serve(sockets=[listening]))

    def _leave(self) -> None:
        """Answer a client's last calls, too; after a whole session it may take its time to call again."""
        with self.changed:
            played = self.game.phase is Phase.WAITING and self.game.turn > 0
            self.game.close()
            self.changed.notify_all()
        with suppress(KeyboardInterrupt):  # An experiment that Ctrl-C has ended need not wait.
            self._thread.join(None if played and self.options.port is None else _GRACE)


_NEWEST: Final[dict[int | None, MCPAgent]] = {}
"""The newest agent of each address: of a port, or None for stdio. At 0 several may be played at once, each
at a port of its own; elsewhere its game is that of all before it."""


def play(agent: LanguageAgent, tool: str, arguments: Mapping[str, Any]) -> Answer:
    """Return the answer to a call of a tool, after `_PATIENCE` at the latest.

    Raises:
        GameOver: the session is over.
    """
    game, turn = agent.game, arguments.get("turn")
    with agent.changed:
        if tool == "look":
            agent.changed.wait_for(lambda: game.phase in (Phase.CHOOSING, Phase.CLOSED), _PATIENCE)
            return game.look(image=bool(arguments.get("image")))
        try:
            if type(turn) is not int:
                raise NotNow(f"turn is a whole number; the current turn is {game.turn}")
            if turn == game.turn and game.phase is Phase.CHOOSING:
                game.note(json.dumps(arguments, ensure_ascii=False))
            if tool == "act":
                game.act(turn, arguments.get("actions"), arguments.get("until", Until.END))
            else:
                game.give_up(turn)
        except NotNow as error:
            return Answer(str(error), game.view().data, error=True)
        agent.changed.notify_all()
        agent.changed.wait_for(lambda: game.answer(turn) is not None, _PATIENCE)
        view = game.view()
        return game.answer(turn) or view._replace(text=f"{view.text} Repeat this call to get its answer.")


def make_server(agent: MCPAgent) -> Server[Any]:
    """Return the server by which a client plays as `agent`."""
    import mcp_types as types
    from anyio import CapacityLimiter
    from anyio.to_thread import run_sync
    from mcp.server.lowlevel import Server
    from mcp.shared.exceptions import MCPError

    limiter = CapacityLimiter(_MOST_CALLS)
    tools = []
    for name, (text, properties) in _TOOLS.items():
        required = [each for each in properties if each in ("turn", "actions")]
        given = {"type": "object", "properties": properties, "required": required}
        returned = {"type": "object", "properties": _ANSWER}
        tools.append(types.Tool(name=name, description=text, input_schema=given, output_schema=returned))

    async def list_tools(_context: object, _params: object) -> types.ListToolsResult:
        return types.ListToolsResult(tools=tools)

    async def call_tool(_context: object, params: types.CallToolRequestParams) -> types.CallToolResult:
        if params.name not in _TOOLS:
            raise MCPError(types.INVALID_PARAMS, f"there is no tool {params.name!r:.80}")
        try:
            call = partial(play, agent, params.name, params.arguments or {})
            answer = await run_sync(call, abandon_on_cancel=True, limiter=limiter)
        except GameOver as error:
            raise MCPError(types.INVALID_REQUEST, str(error)) from None
        except GlueError as error:
            return types.CallToolResult(content=[types.TextContent(text=str(error))], is_error=True)
        content: list[Any] = [types.TextContent(text=answer.text)]
        if answer.image is not None:
            image = b64encode(answer.image).decode()
            content.append(types.ImageContent(data=image, mime_type="image/png"))
        data = dict(answer.data)
        return types.CallToolResult(content=content, structured_content=data, is_error=answer.error)

    with agent.changed:
        names = {"version": __version__, "instructions": agent.prompt}
        server = Server("glue-rl", **names, on_list_tools=list_tools, on_call_tool=call_tool)
        agent.instructed.append(server)
    return server


def _has_client() -> bool:
    """Return whether standard input can be a client's: it is there, and no terminal or null device."""
    with suppress(OSError):
        return not stat.S_ISCHR(os.fstat(0).st_mode)
    return False


def _listen(port: int) -> socket.socket:
    try:
        listening = socket.create_server((_HOST, port))
    except OSError as error:
        raise ConfigError(f"cannot serve at port {port}: {error.strerror}", settings=("port",)) from None
    LOG.info("serving the Model Context Protocol at http://%s:%d/mcp", _HOST, listening.getsockname()[1])
    return listening
