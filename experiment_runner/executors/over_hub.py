"""Connect the players of a trial over a hub, our own or a running one.

Players that a trial names are started as child processes, except for those inside. The experiment waits for
the others, and shows the command that starts them.

The addresses at which players join from outside are opened once for a whole run, by `listening`, and
passed to the hub of each trial. No address is opened just to test it: an original RL-Glue program that waits
for its port connects as soon as it is open, and exits when it is closed again.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Collection, Iterator, Sequence, Set
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Final

from experiment_runner.executors import player_command
from experiment_runner.executors.job import AtHub, HubOptions, Joined, Line, Placement, Report
from experiment_runner.executors.players import players_inside
from experiment_runner.plan.plan import Plan, TrialSpec
from experiment_runner.processes.children import KeptAlive, Say
from experiment_runner.processes.scratch import SOCKET, scratch_folder
from glue.client.experiment import connect, connect_over
from glue.engine.experiment import Experiment
from glue.hub.config import DEFAULT_HUB, DEFAULT_SESSION, Bind, HubConfig, LegacyPort
from glue.hub.io.inside import InsideTransport
from glue.hub.io.listener import open_address
from glue.hub.io.server import Hub, renewed_on_hangup
from glue.keys.allowed import HUB, read_keys
from glue.keys.certificates import PUBLIC, SECRET
from glue.legacy.gateway import Gateway, open_legacy_port
from glue.pace import Pace
from glue.plugins.loading import example
from glue.wire.messages import Event, Role

_COMMANDS: Final = {Role.AGENT: "glue-agent", Role.ENVIRONMENT: "glue-env"}


@contextmanager
def listening(plan: Plan, placement: Placement, say: Say) -> Iterator[Placement]:
    """Listen for players from outside during a whole run; yield `placement` with the open addresses.

    `say` shows, once in the run, which of them strangers can reach.

    Raises:
        ConfigError: an address is in use, or is not one of this machine.
    """
    options = placement.hub
    expected = options.hub is None and not (plan.agents and plan.environments)
    outside = _outside(options, expected)
    # Refuses addresses without keys that other machines can reach.
    binds = _binds(options, expected, frozenset(Role))
    HubConfig(bind=binds, insecure=options.insecure)
    with ExitStack() as stack:
        opened = {url: stack.enter_context(open_address(url)) for url in outside}
        legacy = {port: stack.enter_context(open_legacy_port(port)) for port in options.legacy}
        for bind in binds:
            if bind.warning:
                say(bind.announcement(opened[bind.url].endpoint))
        yield replace(placement, opened=opened, opened_legacy=legacy)


def _binds(options: HubOptions, expected: bool, roles: frozenset[Role]) -> tuple[Bind, ...]:
    """Return the addresses of our own hub for players from outside, with the roles that are open to them."""
    keys = None if options.keys is None else read_keys(options.keys)
    if keys is not None:
        roles |= {Role.OBSERVER}  # those whose key permits it
    return tuple(Bind(url, roles, keys=keys) for url in _outside(options, expected))


def _outside(options: HubOptions, expected: bool) -> tuple[str, ...]:
    """Return the addresses at which our own hub listens for players from outside."""
    return options.bind or ((DEFAULT_HUB,) if expected else ())


@contextmanager
def over_hub(
    spec: TrialSpec, placement: Placement, send: Callable[[Report], None], progress: Callable[[], int]
) -> Iterator[Experiment]:
    """Connect the players of a trial over a hub of our own, or a running one; see `open_experiment`."""
    options = placement.hub
    players = {Role.ENVIRONMENT: spec.environment, Role.AGENT: spec.agent}
    named = {role: player for role, player in players.items() if player is not None}
    expected = frozenset(players.keys() - named.keys())
    inside = players_inside(spec, placement)
    session = options.session
    hub: Hub | None = None

    def say(line: str) -> None:
        send(Line(line))

    def notice(event: Event, role: Role, name: str) -> None:
        """Report that a player joined or was lost."""
        if event is not Event.JOINED:
            say(f"{role} {name}" if event is Event.SLOW else f"{role} {name} {event}")
        elif role in expected:
            label, opens, program = name.removesuffix(")").rpartition(" (")  # in the hub's format
            offered = None if hub is None else hub.sessions.capabilities(session, role)
            seeded = offered is None or "seed" in offered
            send(Joined(role, label if opens else name, program if opens else None, seeded))
        if role in expected and event is Event.LOST:
            show_missing({role})

    with ExitStack() as stack:
        # Entered first, so left last: the children exit after our hub has said goodbye to them.
        children = stack.enter_context(ExitStack())
        started: list[KeptAlive] = []
        if options.hub is not None:
            url = options.hub
            show_missing = hints(say, url, session, named.keys())
            glue = connect(
                url, session, key=options.key, hub_key=options.hub_key, wait=options.wait, on_notice=notice
            )
        else:
            hub, url, show_missing = _start_hub(stack, placement, expected, named.keys(), spec.pace, say)
            transport = InsideTransport(hub, inside, session)
            glue = connect_over(
                transport, session, on_notice=notice, num_steps=partial(hub.sessions.num_steps, session)
            )
        stack.enter_context(glue)
        if options.key is None:  # observers would need a key
            send(AtHub(url, session))
        try:
            for role, player in named.items():
                if role not in inside:
                    place = {"hub": url, "session": session, "key": options.key, "hub_key": options.hub_key}
                    checks = {"any_reward": placement.any_reward, "check_actions": placement.check_actions}
                    given = {"options": player.options, "place": place, **checks}
                    child = KeptAlive(
                        f"{role} {player.label}",
                        player_command.MODULE,
                        [role, player.name, json.dumps(given)],
                        say=say,
                        progress=progress,
                        give_up=glue.give_up,
                        dismissed=options.hub is None,
                    )
                    started.append(children.enter_context(child))
            glue.wait_for_players(show_missing)
            yield glue
        except KeyboardInterrupt:
            for child in started:
                child.hurry()
            raise


def _start_hub(
    stack: ExitStack,
    placement: Placement,
    expected: frozenset[Role],
    named: Collection[Role],
    pace: Pace,
    say: Say,
) -> tuple[Hub, str, Callable[[Set[Role]], None]]:
    """Start a hub; return it, its URL for our children, and the function that shows hints."""
    options = placement.hub
    inside = f"ipc://{stack.enter_context(scratch_folder())}/{SOCKET}"
    # A named role is reserved for our own child: only the child can reach the inside address.
    binds = _binds(options, bool(expected), expected or frozenset({Role.OBSERVER}))
    config = HubConfig(bind=(inside, *binds), insecure=options.insecure, pace=pace)
    hub = stack.enter_context(Hub(config, opened=placement.opened))
    if binds and options.keys is not None:
        stack.enter_context(renewed_on_hangup(hub, options.keys))
    legacy = {port: replace(port, roles=expected) for port in options.legacy}
    opened_legacy = {legacy[port]: address for port, address in placement.opened_legacy.items()}
    ports = tuple(Gateway(hub, tuple(legacy.values()), say, opened=opened_legacy).ports)
    for port in ports:
        say(f"original RL-Glue programs join on {port}")
    stack.enter_context(hub.in_background())
    public = hub.endpoints[1] if binds else inside
    if binds and not expected:
        say(f"observers can join at {public}")
    return hub, inside, hints(say, public, options.session, named, ports, options.keys)


def hints(
    say: Say,
    hub: str,
    session: str,
    named: Collection[Role],
    ports: Sequence[LegacyPort] = (),
    keys: Path | None = None,
) -> Callable[[Set[Role]], None]:
    """Return a function that says which players are missing, and which commands start those from outside.

    Args:
        say: shows a line.
        hub: URL at which players from outside join.
        session: the session that they join.
        named: the roles whose players the experiment starts itself; each is mentioned once.
        ports: ports at which original RL-Glue programs join.
        keys: directory of the hub's keys, which players from outside need; None for none.
    """
    where = "" if hub == DEFAULT_HUB else f" --hub {_from_outside(hub)}"
    where += "" if session == DEFAULT_SESSION else f" --session {session}"
    if keys is not None:
        where += f" --key THEIRS{SECRET} --hub-key {keys / HUB}{PUBLIC}"
    if legacy := " or ".join(f"{port.host}:{port.port}" for port in ports if port.session == session):
        where += f"; or an original one on {legacy}"
    starting: set[Role] = set()

    def show(missing: Set[Role]) -> None:
        for role in sorted(missing - starting):
            if role in named:
                starting.add(role)
                say(f"waiting for the {role} to start")
            else:
                command = f"{_COMMANDS[role]} {example(role)}{where}"
                say(f"waiting for an {role}; in another terminal: {command}")

    return show


def _from_outside(endpoint: str) -> str:
    """Return the URL at which outside programs reach our hub; a wildcard becomes the placeholder HOST."""
    for everywhere in ("tcp://0.0.0.0:", "tcp://[::]:"):
        if endpoint.startswith(everywhere):
            return "tcp://HOST:" + endpoint.removeprefix(everywhere)
    return endpoint
