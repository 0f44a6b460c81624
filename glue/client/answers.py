"""A program's player, which carries out each call exactly once, however often the call arrives."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

from glue.client.bodies import READ, write
from glue.console import show_failure
from glue.engine.calls import Handler, name_of, role_calls
from glue.errors import ConfigError, GlueError, RemoteProtocolError, described
from glue.hub.sessions import ONE_RUN
from glue.roles import AgentLike, EnvironmentLike, capabilities
from glue.types import Observation
from glue.wire.beside import carried, readable
from glue.wire.codec import clip
from glue.wire.messages import BESIDE, CALLS, PACE, ErrorCode, Kind, Message, Role

_message: Final = tuple.__new__
"""Constructor of a named tuple, at half the cost of calling its class."""


def failure(call: Message, error: BaseException) -> Message:
    """Print where the player's own code failed in a call; return the ERROR that says so to the hub."""
    if not isinstance(error, GlueError):
        show_failure(error)
    return Message(Kind.ERROR, call.session, call.seq, (str(ErrorCode.EXCEPTION), clip(described(error))))


class ServedPlayer:
    """One agent or environment, in one session: its calls, and its last answer.

    Args:
        role: agent or environment.
        player: the object.
        name: its name for people; by default that of its class.

    Attributes:
        name: its name, for people.
        capabilities: optional calls of its role that it offers.
    """

    def __init__(self, role: Role, player: AgentLike | EnvironmentLike, name: str | None = None) -> None:
        self.name: str = name or name_of(player)
        self.capabilities: tuple[str, ...] = capabilities(player)
        if getattr(player, "env_waits", False):
            self.capabilities += (PACE,)  # the hub says whether it has one
        if getattr(player, "for_one_run", False):
            self.capabilities += (ONE_RUN,)
        self._handlers: Final[dict[Kind, tuple[Handler, Callable[[bytes], Any]]]] = {
            kind: (handler, READ[CALLS[kind].request.body])
            for kind, handler in role_calls(role, player).items()
        }
        self._beside = BESIDE.intersection(self.capabilities) if role is Role.ENVIRONMENT else frozenset()
        self._carried = self._beside  # what the hub carries of it
        self._last_seq = 0
        self._last_call: Message | None = None
        self._last_answer: Message | None = None

    def forget(self) -> None:
        """Forget which calls were answered: a hub that does not know this player has its own count.

        The last call is kept. If exactly this call arrives again, it is from the same hub, which never
        received the answer.
        """
        self._last_seq = 0

    def welcome(self, message: Message) -> None:
        """Note what the hub can carry beside the numbers of observations, according to a WELCOME.

        Raises:
            ConfigError: this hub does not wait for agents, and the player checks their actions.
        """
        confirmed = carried(message)
        if PACE in confirmed:
            raise ConfigError(
                f"{self.name} cannot check actions here: this hub has a rate or a delay, and what is illegal "
                "by now need not be the agent's choice"
            )
        self._carried = self._beside if self._beside <= confirmed else self._beside & confirmed

    def answer(self, message: Message) -> Message | None:
        """Return the answer to a call; the same answer if the call is repeated; None if it is outdated."""
        kind, session, seq, scalars, body = message
        if seq <= self._last_seq:
            return self._last_answer if seq == self._last_seq else None
        if message == self._last_call:
            self._last_seq = seq
            return self._last_answer
        self._last_call = message
        known = self._handlers.get(kind)
        if known is None:
            raise RemoteProtocolError(f"the hub asked {self.name} for {kind.name}")
        handler, read = known
        replied, result = handler(scalars, read(body))
        body = write(result)
        if self._carried is not self._beside and isinstance(result, Observation):
            body = readable(body, self._carried)
        answer = _message(Message, (kind, session, seq, replied, body))
        self._last_seq = seq
        self._last_answer = answer
        return answer
