"""The settings of a run's execution, which do not affect its results."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

from experiment_runner.plan.extras import Summary
from experiment_runner.plan.limits import CHECKPOINT_EVERY, Backend
from experiment_runner.plan.metrics import MetricsPlan
from glue.hub.config import DEFAULT_SESSION, LegacyPort
from glue.hub.io.listener import OpenAddress
from glue.wire.messages import Role

GRACE_SECONDS: Final = 0.5
"""Default time in which a running episode may end before Ctrl-C takes effect."""

BOTH: Final = frozenset({Role.AGENT, Role.ENVIRONMENT})
"""Both players."""


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
    """The places of a trial's players, and how they are connected.

    Args:
        inside: roles whose named players are objects in the process of the trial. Any other player is a
            process, or joins from outside. If both are inside, there is no hub.
        hub: the hub, if a player is not inside.
        opened: the hub's addresses that are already open, by URL.
        opened_legacy: the hub's ports for original RL-Glue programs that are already open.
        any_reward: whether rewards may be infinite or NaN; if not, the first such reward ends the trial, or
            the first such return with an environment from outside.
        check_actions: whether a named environment refuses an action that its task spec or mask forbids.
    """

    inside: frozenset[Role] = frozenset()
    hub: HubOptions = field(default_factory=HubOptions)
    opened: Mapping[str, OpenAddress] = field(default_factory=dict)
    opened_legacy: Mapping[LegacyPort, OpenAddress] = field(default_factory=dict)
    any_reward: bool = False
    check_actions: bool = False

    @property
    def in_process(self) -> bool:
        """Whether both players are objects in the process of the trial."""
        return self.inside >= BOTH


@dataclass(frozen=True, slots=True)
class RunConfig:
    """The settings of the execution of a run.

    Args:
        placement: of the players of each trial.
        checkpoint_every: number of episodes between checkpoints; 0 for none.
        backend: the kind of machine on which trials run.
        workers: maximum number of concurrent trials, each in its own process, or of a job array's tasks. None
            for one trial at a time in this process, one for each processor of a cluster, or no limit.
        address: address of the Ray cluster; None for the one that Ray finds, or one on this machine.
        questions: messages to send to the agent after each episode, and each recorded step.
        metrics: the agents' metrics to record; None for none.
        extras: the environments' extras to record, and as what; see `experiment_runner.plan.extras`.
        grace: seconds in which a running episode may end before Ctrl-C takes effect.
    """

    placement: Placement = field(default_factory=Placement)
    checkpoint_every: int = CHECKPOINT_EVERY
    backend: Backend = Backend.LOCAL
    workers: int | None = None
    address: str | None = None
    questions: tuple[str, ...] = ()
    metrics: MetricsPlan | None = None
    extras: Mapping[str, Summary] = field(default_factory=dict)
    grace: float = GRACE_SECONDS

    @property
    def parallel(self) -> bool:
        """Whether trials run in separate processes, at the same time."""
        return self.backend is not Backend.LOCAL or self.workers is not None
