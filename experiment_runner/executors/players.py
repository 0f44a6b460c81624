"""Connect agent, environment and experiment: in this process, or over a hub.

Players that a trial names are created here, as objects or as child processes; see
`experiment_runner.executors.over_hub` for those that are not in this process.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from experiment_runner.executors.rewards import FiniteRewards
from experiment_runner.plan.plan import TrialSpec
from experiment_runner.processes.children import Say
from glue.engine.experiment import Experiment
from glue.engine.local import local
from glue.errors import ExperimentError
from glue.hub.config import DEFAULT_SESSION, LegacyPort
from glue.hub.io.listener import OpenAddress
from glue.plugins.loading import construct, find
from glue.wire.messages import Role

BOTH: Final = frozenset({Role.AGENT, Role.ENVIRONMENT})
"""Both players."""

Note = Callable[[str, str, str | None, bool], None]
"""Records and shows a player that joined: its role, its name, its language or library, and whether it takes
a seed; True if that is not known."""


@dataclass(frozen=True, slots=True)
class HubOptions:
    """The hub at which the players meet.

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
class Placement:
    """Connection of agent and environment of a trial; it does not affect the results.

    Args:
        inside: roles whose named players are objects in the process of the trial. Any other player is a
            process, or joins from outside. If both are inside, there is no hub.
        hub: the hub, if a player is not inside.
        opened: the hub's addresses that are already open, by URL.
        opened_legacy: the hub's ports for original RL-Glue programs that are already open.
        any_reward: whether rewards may be infinite or NaN; if not, the first such reward ends the trial, or
            the first such return with an environment from outside.
    """

    inside: frozenset[Role] = frozenset()
    hub: HubOptions = field(default_factory=HubOptions)
    opened: Mapping[str, OpenAddress] = field(default_factory=dict)
    opened_legacy: Mapping[LegacyPort, OpenAddress] = field(default_factory=dict)
    any_reward: bool = False

    @property
    def in_process(self) -> bool:
        """Whether both players are objects in the process of the trial."""
        return self.inside >= BOTH


def open_experiment(
    spec: TrialSpec,
    placement: Placement,
    say: Say,
    progress: Callable[[], int],
    note: Note | None = None,
    met: Callable[[str, str], None] | None = None,
) -> AbstractContextManager[Experiment]:
    """Connect the players of a trial.

    Args:
        spec: the trial.
        placement: how the players are connected.
        say: shows a line; may be called from any thread.
        progress: returns the number of finished episodes, to detect a player that is killed repeatedly
            without progress; may be called from any thread.
        note: records each player that joins from outside; None to only show it.
        met: receives the URL of the hub and the session's name, for observers.

    Raises:
        ConfigError: a name, an option or an address is wrong, or an address is in use.
        ExperimentError: a child process cannot be started, or no player is named for a role that is inside.
    """
    if placement.in_process:
        return _in_process(spec, placement)
    from experiment_runner.executors.over_hub import OverHub  # slow to import

    return OverHub(spec, placement, say, progress, note, met)


@contextmanager
def _in_process(spec: TrialSpec, placement: Placement) -> Iterator[Experiment]:
    players = players_inside(spec, placement)
    with local(players[Role.AGENT], players[Role.ENVIRONMENT]) as glue:
        yield glue


def players_inside(spec: TrialSpec, placement: Placement) -> dict[Role, Any]:
    """Return the players that are objects in this process."""
    players = {}
    for role, player in ((Role.AGENT, spec.agent), (Role.ENVIRONMENT, spec.environment)):
        if role in placement.inside:
            if player is None:
                raise ExperimentError(f"name an {role}: none from outside can be inside the trial's process")
            players[role] = construct(find(role, player.name), player.options)
    if Role.ENVIRONMENT in players and not placement.any_reward:
        players[Role.ENVIRONMENT] = FiniteRewards(players[Role.ENVIRONMENT])
    return players
