"""Connect agent, environment and experiment: in this process, or over a hub.

Players that a trial names are created here, as objects or as child processes. For the others the experiment
waits, and shows the command that starts them.

The addresses at which players join from outside are opened once for a whole run, by `listening`, and
passed to the hub of each trial. No address is opened just to test it: an original RL-Glue program that waits
for its port connects as soon as it is open, and exits when it is closed again.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, ExitStack, contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path

from experiment_runner import player_command
from experiment_runner.children import KeptAlive, Say
from experiment_runner.hints import Hints
from experiment_runner.plan import Plan, TrialSpec
from experiment_runner.rewards import FiniteRewards, WatchedRewards
from experiment_runner.scratch import SOCKET, scratch_folder
from glue.client.experiment import connect
from glue.core.config import DEFAULT_HUB, DEFAULT_SESSION, Bind, HubConfig, LegacyPort
from glue.core.experiment import Experiment
from glue.core.local import local
from glue.errors import ExperimentError
from glue.hub.inside import InsideTransport
from glue.hub.listener import OpenAddress, open_address
from glue.hub.renewal import renewed_on_hangup
from glue.hub.server import Hub
from glue.keys.allowed import read_keys
from glue.legacy.gateway import Gateway, open_legacy_port
from glue.players.loading import construct, find
from glue.protocol.messages import Event, Role

__all__ = ["HubOptions", "Meeting", "Note", "listening", "open_experiment"]

Note = Callable[[str, str], None]
"""Records and shows an event: its kind, which is one word, and a line of text."""


@dataclass(frozen=True, slots=True)
class HubOptions:
    """Where the players meet.

    Args:
        hub: URL of a running hub; None to start one.
        bind: addresses of our own hub for players from outside; by default one, if any player is expected.
        session: the session's name.
        wait: timeout in seconds for `hub` to answer; None to wait forever.
        insecure: allow addresses that other machines can reach.
        legacy: ports of our own hub for original RL-Glue programs.
        key: file with the secret key by which `hub` knows the experiment, and the players that it starts.
        hub_key: the public key of `hub`, or a file that holds it.
        keys: directory of the keys of our own hub, which players from outside need; None for none.
    """

    hub: str | None = None
    bind: tuple[str, ...] = ()
    session: str = DEFAULT_SESSION
    wait: float | None = None
    insecure: bool = False
    legacy: tuple[LegacyPort, ...] = ()
    key: str | None = None
    hub_key: str | None = None
    keys: Path | None = None


@dataclass(frozen=True, slots=True)
class Meeting:
    """How agent and environment of a trial are connected; it does not affect the results.

    Args:
        in_process: whether they are objects in one process; otherwise they are processes, connected by a hub.
        hub: which hub, if they are processes.
        opened: the hub's addresses that are already open, by URL.
        opened_legacy: its ports for original RL-Glue programs that are already open.
        any_reward: whether rewards may be infinite or NaN; if not, the first such reward ends the trial.
    """

    in_process: bool = False
    hub: HubOptions = field(default_factory=HubOptions)
    opened: Mapping[str, OpenAddress] = field(default_factory=dict)
    opened_legacy: Mapping[LegacyPort, OpenAddress] = field(default_factory=dict)
    any_reward: bool = False


def open_experiment(
    spec: TrialSpec,
    meeting: Meeting,
    say: Say,
    progress: Callable[[], int],
    note: Note | None = None,
    met: Callable[[str, str], None] | None = None,
) -> AbstractContextManager[Experiment]:
    """Connect the players of a trial.

    Args:
        spec: the trial.
        meeting: how they are connected.
        say: shows a line; may be called from any thread.
        progress: returns how many episodes are done, to detect a player that is killed repeatedly without
            progress; may be called from any thread.
        note: records each player that joins from outside; None to only show it.
        met: takes the URL of the hub, or None, and the session's name; for observers.

    Raises:
        ConfigError: a name, an option or an address is wrong, or an address is in use.
        ExperimentError: a child process cannot be started, or a role is not named in one process.
    """
    if meeting.in_process:
        return _in_process(spec, meeting)
    return _over_hub(spec, meeting, say, progress, note or (lambda kind, text: say(text)), met)


@contextmanager
def listening(plan: Plan, meeting: Meeting) -> Iterator[Meeting]:
    """Listen for players from outside during a whole run; yield `meeting` with the open addresses.

    Raises:
        ConfigError: an address is in use, or is not one of this machine.
    """
    options = meeting.hub
    expected = options.hub is None and not (plan.agents and plan.environments)
    outside = _outside(options, expected)
    # Refuses addresses without keys that other machines can reach.
    HubConfig(bind=_binds(options, expected, frozenset(Role)), insecure=options.insecure)
    with ExitStack() as stack:
        opened = {url: stack.enter_context(open_address(url)) for url in outside}
        legacy = {port: stack.enter_context(open_legacy_port(port)) for port in options.legacy}
        yield replace(meeting, opened=opened, opened_legacy=legacy)


def _binds(options: HubOptions, expected: bool, roles: frozenset[Role]) -> tuple[Bind, ...]:
    """Return the addresses of our own hub for players from outside, with the roles that are open to them."""
    keys = None if options.keys is None else read_keys(options.keys)
    if keys is not None:
        roles |= {Role.OBSERVER}  # those whose key says so
    return tuple(Bind(url, roles, keys=keys) for url in _outside(options, expected))


def _outside(options: HubOptions, expected: bool) -> tuple[str, ...]:
    """Return where our own hub listens for players from outside."""
    return options.bind or ((DEFAULT_HUB,) if expected else ())


@contextmanager
def _in_process(spec: TrialSpec, meeting: Meeting) -> Iterator[Experiment]:
    players = {}
    for role, player in ((Role.AGENT, spec.agent), (Role.ENVIRONMENT, spec.environment)):
        if player is None:
            raise ExperimentError(f"name an {role}: without a hub, none can join from outside")
        players[role] = construct(find(role, player.name), player.options)
    environment = players[Role.ENVIRONMENT]
    if not meeting.any_reward:
        environment = FiniteRewards(environment)
    with local(players[Role.AGENT], environment) as glue:
        yield glue


@contextmanager
def _over_hub(
    spec: TrialSpec,
    meeting: Meeting,
    say: Say,
    progress: Callable[[], int],
    note: Note,
    met: Callable[[str, str], None] | None,
) -> Iterator[Experiment]:
    options = meeting.hub
    players = {Role.ENVIRONMENT: spec.environment, Role.AGENT: spec.agent}
    named = {role: player for role, player in players.items() if player is not None}
    expected = frozenset(players.keys() - named.keys())
    public = options.hub or ""
    ports: tuple[LegacyPort, ...] = ()
    warnings: list[str] = []
    present: dict[Role, str] = {}

    def notice(event: str, role: str, name: str) -> None:
        line = f"{role} {name} {event}"
        present[Role(role)] = name
        if event != Event.JOINED:
            say(line)
        elif Role(role) in expected:
            note("joined", line)
        if Role(role) in expected and event == Event.LOST:
            hints.show(frozenset({Role(role)}))

    with ExitStack() as stack:
        # Entered first, so left last: the children exit after our hub has said goodbye to them.
        children = stack.enter_context(KeptAlive(say, progress, dismissed=options.hub is None))
        if options.hub is None:
            inside = f"ipc://{stack.enter_context(scratch_folder())}/{SOCKET}"
            # Only our own child may take a role that is named: only it can reach the inside address.
            binds = _binds(options, True, expected) if expected else ()
            config = HubConfig(bind=(inside, *binds), insecure=options.insecure)
            hub = stack.enter_context(Hub(config, opened=meeting.opened))
            if binds and options.keys is not None:
                stack.enter_context(renewed_on_hangup(hub, options.keys))
            legacy = {port: replace(port, roles=expected) for port in options.legacy}
            opened_legacy = {legacy[port]: address for port, address in meeting.opened_legacy.items()}
            ports = tuple(Gateway(hub, tuple(legacy.values()), say, opened=opened_legacy).ports)
            for port in ports:
                say(f"original RL-Glue programs join on {port}")
            stack.enter_context(hub.in_background())
            pairs = zip(binds, hub.endpoints[1:], strict=True)
            warnings = [f"{bind.warning}listening on {endpoint}" for bind, endpoint in pairs if bind.warning]
            public = hub.endpoints[1] if binds else inside
            transport: InsideTransport | None = InsideTransport(hub)
        else:
            inside, transport = options.hub, None
        hints = Hints(say, public, options.session, named.keys(), ports, options.keys, warnings)
        glue = connect(
            inside,
            options.session,
            key=options.key,
            hub_key=options.hub_key,
            wait=options.wait,
            log=say,
            on_notice=notice,
            transport=transport,
        )
        stack.enter_context(glue)
        if met is not None and options.key is None:  # nobody looks on without a key of their own
            met(inside, options.session)
        for role, player in named.items():
            arguments = player_command.arguments(
                role,
                player.name,
                player.options,
                inside,
                options.session,
                meeting.any_reward,
                options.key,
                options.hub_key,
            )
            children.start(f"{role} {player.label}", player_command.MODULE, arguments, glue.give_up)
        try:
            glue.wait_for_players(hints.show)
            if Role.ENVIRONMENT in expected and not meeting.any_reward:
                yield WatchedRewards(glue, lambda: present[Role.ENVIRONMENT])
            else:
                yield glue
        except KeyboardInterrupt:
            children.hurry()
            raise
