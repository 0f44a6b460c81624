"""A player that lies: its answers are right, and among them it sends what no program should.

Most lies must change nothing: wrong numbers, the other role's answers, answers to nobody's question, a second
HELLO. Two kinds harm the liar's own session, whose episode is then void, but no other program."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from random import Random
from typing import Any, Final

from glue.types import Action, Observation
from glue.wire.messages import Kind, Message
from glue.wire.steps import STEPS

HARM: Final = 0.04
"""Share of the lies that harm the liar's session."""


class Lying:
    """The connection of a liar; all but `send_message` is that of an honest program.

    Args:
        transport: the connection of an honest program.
        random: draws the lies.
        others: names of sessions in which it has no role.
        honest: returns whether the time for lies is over.
        harmed: called before a lie that harms the liar's session.
    """

    def __init__(
        self,
        transport: Any,
        random: Random,
        others: Iterable[str],
        honest: Callable[[], bool],
        harmed: Callable[[], None],
    ) -> None:
        self._transport = transport
        self._random = random
        self._others = ("nobody", *others)
        self._honest = honest
        self._harmed = harmed
        self._hello: dict[str, Message] = {}

    def __getattr__(self, name: str) -> Any:
        return getattr(self._transport, name)

    def send_message(self, message: Message) -> bool:
        """Send a message, and lies before or after it."""
        if message.kind is Kind.HELLO:
            self._hello[message.session] = message
        if message.kind not in STEPS or self._honest() or self._random.random() < 0.7:
            return bool(self._transport.send_message(message))
        told = self._harmful(message) if self._random.random() < HARM else self._idle(message)
        sent = [self._transport.send_message(each) for each in told]
        return all(sent)

    def _harmful(self, true: Message) -> Iterator[Message]:
        """Yield, in place of a true answer, one of a wrong length, or to another question of its role."""
        self._harmed()
        if self._random.random() < 0.5:
            yield true._replace(body=true.body[: self._random.randrange(len(true.body))])
        elif true.kind is Kind.AGENT_STEP:
            yield true._replace(kind=Kind.AGENT_START)
        else:
            yield true._replace(kind=Kind.ENV_START, scalars=())

    def _idle(self, true: Message) -> Iterator[Message]:
        """Yield a true answer with a lie that must not change anything."""
        random, seq = self._random, true.seq
        short = true._replace(body=Observation(ints=[7] * random.randrange(3)).body)
        if true.kind is Kind.AGENT_STEP:
            other = Message(Kind.ENV_STEP, true.session, seq + 1, (9.0, True), Observation(ints=[9]).body)
        else:
            other = Message(Kind.AGENT_STEP, true.session, seq + 1, (), Action(ints=[9]).body)
        before, after = random.choice(
            (
                (short._replace(seq=0), true),
                (short._replace(seq=random.randrange(1, seq)), short._replace(seq=random.randrange(1, seq))),
                (short._replace(seq=seq + random.randrange(1, 1000)), true),
                (short._replace(session=random.choice(self._others)), true),
                (Message(Kind.RL_CLEANUP, true.session, seq), Message(Kind.OBSERVE, true.session, 0, (9,))),
                (self._hello[true.session], other),
                (true, other),
            )
        )
        yield before
        yield true
        yield after
