"""The players of one program, and how they answer calls: each exactly once, however often it arrives."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from typing import Final

from glue.client.bodies import READ, write
from glue.client.link import Link
from glue.core.calls import Handler, name_of, role_calls
from glue.errors import RemoteProtocolError
from glue.protocol.messages import CALLS, Kind, Message, Role
from glue.protocol.steps import Step, StepFormat, step_formats
from glue.roles import Agent, Environment, capabilities
from glue.types import Action, Observation

__all__ = ["Player", "Players"]

_TOGETHER_SECONDS: Final = 200e-6
"""How long the first answer waits for others to be sent with it: a system call or two, no slow player."""

_LARGE: Final = 65_536
"""Bytes of an answer that none waits for."""


class Player:
    """One agent or environment, in one session: what it can be asked, and its last answer.

    Attributes:
        name: what people call it.
        capabilities: what it offers beyond its role.
        last_call: the call that was answered last, or that is being answered.
    """

    def __init__(self, role: Role, session: str, player: Agent | Environment) -> None:
        self._session = session
        self._step = kind = Kind.AGENT_STEP if role is Role.AGENT else Kind.ENV_STEP
        self.step, self._reply = step_formats(kind, session)
        self._read = Observation._wrap if role is Role.AGENT else Action._wrap  # the body has been checked
        self.name = name_of(player)
        self.capabilities = capabilities(player)
        self._handlers: dict[Kind, Handler] = role_calls(role, player)
        self._last_seq = 0
        self.last_call: Message | None = None
        self._last_answer: Message | None = None

    def forget(self) -> None:
        """Forget which calls were answered: a hub that does not know this player has a count of its own.

        The last call is kept. If this very call comes again, it is the same hub, which never received
        the answer.
        """
        self._last_seq = 0

    def answer(self, message: Message) -> Message | None:
        """Return the answer to a call; the same one if the call is repeated; None if it is outdated."""
        kind, session, seq, scalars, body = message
        if seq <= self._last_seq:
            return self._last_answer if seq == self._last_seq else None
        if message == self.last_call:
            self._last_seq = seq
            return self._last_answer
        self.last_call = message
        handler = self._handlers.get(kind)
        if handler is None:
            raise RemoteProtocolError(f"the hub asked {self.name} for {kind.name}")
        replied, result = handler(scalars, READ[CALLS[kind].request.body](body))
        answer = Message(kind, session, seq, replied, write(result))
        self._last_seq = seq
        self._last_answer = answer
        return answer

    def answer_steps(self, link: Link) -> None:
        """Answer one step after the other, each in two system calls, until something else arrives."""
        kind, session, reply, read = self._step, self._session, self._reply, self._read
        handler = self._handlers[kind]
        send = link.send_step
        call = answer = None
        try:
            for call in link.receive_steps(self.step, self._last_seq):
                seq, scalars, body = call
                replied, result = handler(scalars, read(body))
                answer = seq, replied, result._body
                send(reply, *answer)
        finally:
            if call is not None:
                self.last_call = Message(kind, session, *call)
            if answer is not None:
                self._last_seq = answer[0]
                self._last_answer = Message(kind, session, *answer)

    def answer_step(self, call: Step, link: Link) -> tuple[StepFormat, Step] | None:
        """Answer a step: return the answer, to be sent along with those of other sessions.

        If the step is repeated, or outdated, the reply is sent here, if there is one, and None returned.
        """
        kind, session = self._step, self._session
        message = Message(kind, session, *call)
        if not 0 < self._last_seq < message.seq:
            repeated = self.answer(message)
            if repeated is not None:
                link.send(repeated)
            return None
        self.last_call = message
        replied, result = self._handlers[kind](message.scalars, self._read(message.body))
        body = result._body
        link.check_size(kind, body)
        self._last_seq = message.seq
        self._last_answer = Message(kind, session, message.seq, replied, body)
        return self._reply, (message.seq, replied, body)


class Players:
    """All players of one program, each in a session of its own.

    Attributes:
        names: for each session, the name to show to people, and the capabilities offered.
        asked: the player called last.
    """

    def __init__(self, role: Role, players: Mapping[str, Agent] | Mapping[str, Environment]) -> None:
        self._players = {session: Player(role, session, player) for session, player in players.items()}
        self._steps = {player.step.lead: player.step for player in self._players.values()}
        self.names = {
            session: (player.name, player.capabilities) for session, player in self._players.items()
        }
        self.asked: Player | None = None

    def get(self, session: str) -> Player | None:
        """Return the player of a session, if there is one."""
        return self._players.get(session)

    def answer(self, call: Message, link: Link) -> None:
        """Answer a call and, after it, one step after the other, until something else arrives."""
        self.asked = player = self._players[call.session]
        answer = player.answer(call)
        if answer is not None:
            link.send(answer)
        if len(self._players) == 1:
            player.answer_steps(link)
            return
        for calls in link.receive_batches(self._steps):
            self._answer_batch(calls, link)

    def _answer_batch(self, calls: Sequence[tuple[StepFormat, Step]], link: Link) -> None:
        """Answer steps of several sessions, in one system call unless they are slow or large."""
        answers: list[tuple[StepFormat, Step]] = []
        until = time.monotonic() + _TOGETHER_SECONDS
        try:
            for form, step in calls:
                self.asked = player = self._players[form.session]
                answer = player.answer_step(step, link)
                if answer is not None:
                    answers.append(answer)
                    if time.monotonic() >= until or len(answer[1][2]) > _LARGE:
                        link.send_steps(answers)
                        answers.clear()
                        until = time.monotonic() + _TOGETHER_SECONDS
        finally:
            if answers:
                link.send_steps(answers)
