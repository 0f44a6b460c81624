"""Observe a session of a hub without taking part in it.

    from glue.client.observer import observe

    with observe("tcp://127.0.0.1:4097") as observer:
        observer.want(100)
        for seen in observer:
            print(seen)

An observer yields `StartSeen`, `StepSeen`, `TaskSpecSeen` and `AnswerSeen`. It is shown as many moments, that
is starts and steps, as it wants, and misses the others.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

from glue.client.link import Link
from glue.client.target import Target, find_target
from glue.closing import Closing
from glue.types import Action, Observation, body_size
from glue.wire.messages import BESIDE, Kind, Message, Role


class TaskSpecSeen(NamedTuple):
    """The task spec that the environment returned from init."""

    text: str


class StartSeen(NamedTuple):
    """An episode has begun. `episode` counts those that began since the session was first observed."""

    episode: int
    observation: Observation


class StepSeen(NamedTuple):
    """A step of the environment, with the counters of the episode after it.

    `episode` is 0 if it began before the session was observed; `num_steps` is RL_num_steps, and `terminal`
    may be `glue.types.CUT_OFF`.
    """

    episode: int
    num_steps: int
    episode_return: float
    reward: float
    terminal: bool | int
    observation: Observation
    action: Action


class AnswerSeen(NamedTuple):
    """The agent's answer to a message from the experiment."""

    message: str
    answer: str


Seen = TaskSpecSeen | StartSeen | StepSeen | AnswerSeen


def observe(
    hub: str | None = None,
    session: str | None = None,
    *,
    key: str | Path | None = None,
    hub_key: str | Path | None = None,
    name: str = "observer",
    wait: float | None = 10.0,
) -> Observer:
    """Return an observer of `session` at `hub`, once the hub has let it in.

    Args:
        hub: see `glue.client.experiment.connect`, as for the other arguments.
        session: name of the session; it has to exist.
        key: file with the secret key by which the hub knows this program.
        hub_key: the hub's public key, or a file that holds it; needed with `key`.
        name: name of this program in the log of the hub.
        wait: seconds to wait for the hub to answer before raising HubUnreachable; None waits for ever.

    Raises:
        ConfigError: an address, a key or a session name is malformed, or the host's name does not resolve.
        HubUnreachable: no hub has answered within `wait` seconds.
        Refused: the hub does not let it in: there is no such session, the session has the maximum number of
            observers, or this address or key is not for observers.
    """
    return Observer(find_target(hub, session, key, hub_key), name, wait)


class Observer(Closing):
    """A connection that is shown the events of a session; iterate over it. Made by `observe`.

    Attributes:
        missed: number of moments that were not requested, or not read in time, as far as is known.
    """

    def __init__(self, target: Target, name: str, wait: float | None) -> None:
        self.missed: int = 0
        self._session = target.session
        self._number = 0
        self._wanted = 0
        names = {target.session: (name, tuple(sorted(BESIDE)))}
        self._link = Link(Role.OBSERVER, target.hub, names, wait, None, key=target.key)
        try:
            while not self._link.ready(self._session):
                self._link.receive()
        except BaseException:
            self.close()
            raise

    @property
    def connected(self) -> bool:
        """Whether the hub has let it in; False from the loss of a connection until it is let in again."""
        return self._link.connected and self._link.ready(self._session)

    def want(self, moments: int) -> None:
        """Ask to be shown the next `moments` moments, in place of any earlier request."""
        self._wanted = moments
        if self._link.ready(self._session):
            self._ask()

    def receive(self) -> Seen | None:
        """Return the next observed event; None if none arrives within a heartbeat interval.

        Raises:
            HubClosed: the session is over, or the hub ends.
            Refused: the connection was lost, and the hub does not let this observer in again.
        """
        message = self._link.receive()
        if message is None:
            return None
        if message.kind is Kind.WELCOME:
            # Over a new connection the hub counts from zero, and does not know the earlier request.
            self._number = 0
            self._ask()
            return None
        seen = _read(message)
        if seen is None:
            return None
        if message.seq:  # a task spec has no number
            self.missed += max(0, message.seq - self._number - 1)
            self._number = message.seq
        if isinstance(seen, StartSeen | StepSeen):
            self._wanted = max(0, self._wanted - 1)
        return seen

    def __iter__(self) -> Iterator[Seen]:
        while True:
            seen = self.receive()
            if seen is not None:
                yield seen

    def close(self) -> None:
        """Leave the session."""
        self._link.close("has seen enough")

    def _ask(self) -> None:
        if self._wanted:
            self._link.send(Message(Kind.OBSERVE, self._session, 0, (self._wanted,)))


def _read(message: Message) -> Seen | None:
    scalars: Any = message.scalars
    body = message.body
    match message.kind:
        case Kind.OBSERVED_INIT:
            return TaskSpecSeen(body.decode(errors="replace"))
        case Kind.OBSERVED_START:
            return StartSeen(scalars[0], Observation.from_body(body))
        case Kind.OBSERVED_STEP:
            cut = body_size(body)
            seen = Observation.from_body(body[:cut]), Action.from_body(body[cut:])
            episode, num_steps, episode_return, reward, terminal = scalars
            return StepSeen(episode, num_steps, episode_return, reward, terminal, *seen)
        case Kind.OBSERVED_MESSAGE:
            return AnswerSeen(scalars[0], body.decode(errors="replace"))
    return None
