"""Bring agent, environment and experiment together: in this process, or over a hub.

Roles that a trial names are made here, as objects or as child processes; roles that it leaves out are
waited for, and whoever is looking is told which command starts them.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from typing import Final

import zmq

from experiment_runner.plan import RoleSpec, TrialSpec
from glue.client import connect as connect_to_hub
from glue.config import DEFAULT_HUB, DEFAULT_SESSION, HubConfig, LegacyPort
from glue.errors import ExperimentError
from glue.experiment import Experiment
from glue.hub import Hub
from glue.legacy.gateway import Gateway
from glue.loading import find
from glue.local import connect as connect_locally
from glue.messages import Event, Role
from glue.options import Value, build, parameters

__all__ = ["HubOptions", "Say", "in_process", "over_hub", "player_arguments"]

Say = Callable[[str], None]
"""Takes a line for people."""

_MODULES: Final = {Role.AGENT: "agents.cli", Role.ENVIRONMENT: "env_server.cli"}
_COMMANDS: Final = {Role.AGENT: "glue-agent", Role.ENVIRONMENT: "glue-env"}
_EXAMPLES: Final = {Role.AGENT: "random", Role.ENVIRONMENT: "mines"}

_INPROC: Final = "inproc://experiment"
_HOPELESS_DEATHS: Final = 3
_HOPELESS_SECONDS: Final = 2.0
_FAREWELL_SECONDS: Final = 3.0


@dataclass(frozen=True, slots=True)
class HubOptions:
    """Where the players meet.

    Args:
        hub: URL of a hub that runs already; None for one of our own.
        bind: addresses of our own hub for players from outside; by default one, if any is expected.
        session: the session's name.
        insecure: allow addresses that other machines can reach.
        legacy: ports of our own hub for original RL-Glue programs.
    """

    hub: str | None = None
    bind: tuple[str, ...] = ()
    session: str = DEFAULT_SESSION
    insecure: bool = False
    legacy: tuple[LegacyPort, ...] = ()


@contextmanager
def in_process(spec: TrialSpec) -> Iterator[Experiment]:
    """Connect agent and environment of `spec` as objects of this process.

    Raises:
        ConfigError: a name or an option is wrong.
        ExperimentError: a role is left out, which only a hub can wait for.
    """
    players = {}
    for role, player in ((Role.AGENT, spec.agent), (Role.ENVIRONMENT, spec.environment)):
        if player is None:
            raise ExperimentError(f"in one process the {role} must be named: --{_flag(role)} NAME")
        players[role] = build(find(role, player.name), player.options)
    with connect_locally(players[Role.AGENT], players[Role.ENVIRONMENT]) as glue:
        yield glue


@contextmanager
def over_hub(spec: TrialSpec, options: HubOptions, say: Say) -> Iterator[Experiment]:
    """Connect agent and environment of `spec` over a hub, as processes of their own.

    Raises:
        ConfigError: an address is wrong or in use.
        ExperimentError: a child process cannot be started.
    """
    players = {Role.ENVIRONMENT: spec.environment, Role.AGENT: spec.agent}
    named = {role: player for role, player in players.items() if player is not None}

    def notice(event: str, role: str, name: str) -> None:
        if event != Event.JOINED or Role(role) not in named:
            say(f"{role} {name} {event}")

    with ExitStack() as stack:
        # Entered first, so left last: the children go when the hub has said goodbye to them.
        children = stack.enter_context(_Children(say))
        context = stack.enter_context(zmq.Context())
        if options.hub is None:
            folder = stack.enter_context(tempfile.TemporaryDirectory(prefix="glue-"))
            inside, address = f"ipc://{folder}/hub", _INPROC
            outside = options.bind or ((DEFAULT_HUB,) if len(named) < len(players) else ())
            config = HubConfig(bind=(_INPROC, inside, *outside), insecure=options.insecure)
            hub = Hub(config, context)
            for port in Gateway(hub, options.legacy, say).ports:
                say(f"original RL-Glue programs join on {port}")
            stack.enter_context(hub.in_background())
            public = hub.endpoints[2] if outside else inside
        else:
            inside = public = address = options.hub
        glue = connect_to_hub(address, options.session, context=context, log=say, on_notice=notice)
        stack.enter_context(glue)
        for role, player in named.items():
            children.start(role, player, inside, options.session, glue.give_up)
        glue.wait_for_players(lambda missing: say(_missing(missing, named, public, options.session)))
        yield glue


def player_arguments(
    role: Role, name: str, options: Mapping[str, Value], hub: str, session: str
) -> list[str]:
    """Return the arguments of glue-agent or glue-env that start this player."""
    arguments = [name]
    known = parameters(find(role, name)) if options else {}
    for key, value in options.items():
        flag = known[key].flag
        if isinstance(value, bool):
            arguments.append(f"--{flag}" if value else f"--no-{flag}")
        else:
            arguments.append(f"--{flag}={value}")
    if hub != DEFAULT_HUB:
        arguments += ["--hub", hub]
    if session != DEFAULT_SESSION:
        arguments += ["--session", session]
    return arguments


def _missing(missing: frozenset[Role], named: Mapping[Role, object], hub: str, session: str) -> str:
    lines = []
    for role in sorted(missing):
        if role in named:
            lines.append(f"waiting for the {role} to start")
        else:
            arguments = " ".join(player_arguments(role, _EXAMPLES[role], {}, hub, session))
            lines.append(f"waiting for an {role}; in another terminal: {_COMMANDS[role]} {arguments}")
    return "\n".join(lines)


def _flag(role: Role) -> str:
    return "agent" if role is Role.AGENT else "env"


class _Children:
    """Players as child processes: started again if they are killed, ended with the experiment."""

    def __init__(self, say: Say) -> None:
        self._say = say
        self._children: list[_Child] = []

    def start(
        self, role: Role, player: RoleSpec, hub: str, session: str, give_up: Callable[[str], None]
    ) -> None:
        """Start a player. If it cannot be kept alive, `give_up` is called with the reason."""
        arguments = player_arguments(role, player.name, player.options, hub, session)
        command = [sys.executable, "-m", _MODULES[role], *arguments, "--quiet"]
        self._children.append(_Child(f"{role} {player.name}", command, self._say, give_up))

    def __enter__(self) -> _Children:
        return self

    def __exit__(self, *_: object) -> None:
        for child in self._children:
            child.leave()
        for child in self._children:
            child.end()


class _Child:
    """One child process and the thread that watches it.

    A process that ends by itself has said why, and is not started again.
    """

    def __init__(self, label: str, command: list[str], say: Say, give_up: Callable[[str], None]) -> None:
        self._label = label
        self._command = command
        self._say = say
        self._give_up = give_up
        self._leaving = False
        self._process = self._start()
        self._watcher = threading.Thread(target=self._watch, name=label, daemon=True)
        self._watcher.start()

    def leave(self) -> None:
        """The experiment is over: from now on the process may end."""
        self._leaving = True

    def end(self) -> None:
        """Wait a moment for the process to end, as it does when its hub says goodbye; then make it."""
        for insist in (self._process.terminate, self._process.kill):
            try:
                self._process.wait(_FAREWELL_SECONDS)
            except subprocess.TimeoutExpired:
                insist()
        self._process.wait()
        self._watcher.join()

    def _start(self) -> subprocess.Popen[bytes]:
        try:
            return subprocess.Popen(self._command, stdin=subprocess.DEVNULL)
        except OSError as error:
            raise ExperimentError(f"cannot start the {self._label}: {error}") from error

    def _watch(self) -> None:
        deaths = 0
        while True:
            began = time.monotonic()
            status = self._process.wait()
            if self._leaving:
                return
            deaths = deaths + 1 if time.monotonic() - began < _HOPELESS_SECONDS else 1
            how = f"ended with status {status}" if status >= 0 else f"was killed by signal {-status}"
            if status >= 0 or deaths >= _HOPELESS_DEATHS:
                self._give_up(f"the {self._label} {how}")
                return
            self._say(f"the {self._label} {how}; starting it again")
            self._process = self._start()
