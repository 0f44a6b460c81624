"""Connect the players of a trial over a hub, our own or a running one.

Players that a trial names are started as child processes, except for those inside. The experiment waits for
the others, and shows the command that starts them.

The addresses at which players join from outside are opened once for a whole run, by `listening`, and
passed to the hub of each trial. No address is opened just to test it: an original RL-Glue program that waits
for its port connects as soon as it is open, and exits when it is closed again.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from functools import partial
from types import TracebackType

from experiment_runner.executors import player_command
from experiment_runner.executors.hints import Hints
from experiment_runner.executors.players import HubOptions, Note, Placement, players_inside
from experiment_runner.plan.plan import Plan, TrialSpec
from experiment_runner.processes.children import KeptAlive, Say
from experiment_runner.processes.scratch import SOCKET, scratch_folder
from glue.client.experiment import connect, connect_over
from glue.engine.experiment import Experiment
from glue.hub.config import DEFAULT_HUB, Bind, HubConfig
from glue.hub.io.inside import InsideTransport
from glue.hub.io.listener import open_address
from glue.hub.io.server import Hub, renewed_on_hangup
from glue.keys.allowed import read_keys
from glue.legacy.gateway import Gateway, open_legacy_port
from glue.wire.messages import Event, Role


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


class OverHub:
    """The players of a trial as processes, connected by a hub of our own or by a running one.

    A context manager that yields the connected experiment.
    """

    def __init__(
        self,
        spec: TrialSpec,
        placement: Placement,
        say: Say,
        progress: Callable[[], int],
        note: Note | None,
        met: Callable[[str, str], None] | None,
    ) -> None:
        players = {Role.ENVIRONMENT: spec.environment, Role.AGENT: spec.agent}
        self._inside = players_inside(spec, placement)
        self._named = {role: player for role, player in players.items() if player is not None}
        self._expected = frozenset(players.keys() - self._named.keys())
        self._placement = placement
        self._options = placement.hub
        self._say = say
        self._note = note
        self._met = met
        # Entered first, so left last: the children exit after our hub has said goodbye to them.
        self._hub: Hub | None = None
        self._children = KeptAlive(say, progress, dismissed=self._options.hub is None)
        self._stack = ExitStack()

    def __enter__(self) -> Experiment:
        with ExitStack() as stack:
            stack.enter_context(self._children)
            experiment = self._start(stack)
            self._stack = stack.pop_all()
        return experiment

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if isinstance(error, KeyboardInterrupt):
            self._children.hurry()
        self._stack.__exit__(kind, error, trace)

    def _start(self, stack: ExitStack) -> Experiment:
        """Start the hub, unless one is running, and the players that are named; wait for all players."""
        options = self._options
        if options.hub is None:
            url, transport, hints = self._start_hub(stack)
        else:
            url, transport = options.hub, None
            hints = Hints(self._say, url, options.session, self._named.keys())
        self._hints = hints
        session = options.session
        if transport is not None and self._hub is not None:
            steps = partial(self._hub.sessions.num_steps, session)
            glue = connect_over(transport, session, on_notice=self._notice, num_steps=steps)
        else:
            glue = connect(
                url,
                session,
                key=options.key,
                hub_key=options.hub_key,
                wait=options.wait,
                on_notice=self._notice,
            )
        stack.enter_context(glue)
        if self._met is not None and options.key is None:  # observers would need a key
            self._met(url, options.session)
        for role, player in self._named.items():
            if role in self._inside:
                continue
            arguments = player_command.arguments(
                role,
                player.name,
                player.options,
                url,
                options.session,
                self._placement.any_reward,
                options.key,
                options.hub_key,
            )
            self._children.start(f"{role} {player.label}", player_command.MODULE, arguments, glue.give_up)
        try:
            glue.wait_for_players(hints.show)
        except KeyboardInterrupt:
            self._children.hurry()
            raise
        return glue

    def _start_hub(self, stack: ExitStack) -> tuple[str, InsideTransport, Hints]:
        """Start a hub; return its URL for our children, the experiment's transport, and the hints."""
        options, placement, expected = self._options, self._placement, self._expected
        inside = f"ipc://{stack.enter_context(scratch_folder())}/{SOCKET}"
        # A named role is reserved for our own child: only the child can reach the inside address.
        binds = _binds(options, bool(expected), expected or frozenset({Role.OBSERVER}))
        config = HubConfig(bind=(inside, *binds), insecure=options.insecure)
        self._hub = hub = stack.enter_context(Hub(config, opened=placement.opened))
        if binds and options.keys is not None:
            stack.enter_context(renewed_on_hangup(hub, options.keys))
        legacy = {port: replace(port, roles=expected) for port in options.legacy}
        opened_legacy = {legacy[port]: address for port, address in placement.opened_legacy.items()}
        ports = tuple(Gateway(hub, tuple(legacy.values()), self._say, opened=opened_legacy).ports)
        for port in ports:
            self._say(f"original RL-Glue programs join on {port}")
        stack.enter_context(hub.in_background())
        public = hub.endpoints[1] if binds else inside
        if binds and not expected:
            self._say(f"observers can join at {public}")
        hints = Hints(self._say, public, options.session, self._named.keys(), ports, options.keys)
        return inside, InsideTransport(hub, self._inside, options.session), hints

    def _notice(self, event: Event, role: Role, name: str) -> None:
        """Show or record that a player joined or was lost."""
        outside = role in self._expected
        if event is Event.SLOW:
            self._say(f"{role} {name}")
        elif event is not Event.JOINED or (self._note is None and outside):
            self._say(f"{role} {name} {event}")
        elif self._note is not None and outside:
            label, opens, program = name.removesuffix(")").rpartition(" (")  # in the hub's format
            if not opens:
                label, program = name, ""
            self._note(role, label, program or None, self._takes_seed(role))
        if outside and event is Event.LOST:
            self._hints.show(frozenset({role}))

    def _takes_seed(self, role: Role) -> bool:
        """Return whether a player offers to be seeded; True if that is not known."""
        if self._hub is None:
            return True
        offered = self._hub.sessions.capabilities(self._options.session, role)
        return offered is None or "seed" in offered
