"""The kit as the hub of an experiment: the mirror of docs/clients.md."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import cycle
from typing import Any, Final

from glue.client.bodies import READ, write
from glue.conform.clients.harness import SPEC, Exchange, Harness
from glue.conform.clients.mirror import carry_out
from glue.engine.experiment import Experiment
from glue.types import AbstractType, Action, Observation
from glue.wire.codec import FROM_HUB, encode
from glue.wire.messages import CALLS, PLAYERS, Event, Kind, Message, Value

SEEN: Final = Observation([3, 5], [0.5], b"ab")
DONE: Final = Action([7], [-0.25], b"c")
BOTH: Final = SEEN.body + DONE.body

_NOTHING: Final = Observation()


@dataclass(frozen=True)
class Order:
    """A verb that the mirror is told to call, and the kit's reply to the resulting request."""

    verb: str
    argument: bytes = b""
    shown: AbstractType = _NOTHING
    reward: float = 0.0
    scalars: tuple[Value, ...] = ()
    body: bytes = b""

    @property
    def observation(self) -> Observation:
        """The order as the observation of RL_ENV_STEP."""
        chars = self.verb.encode() + (b" " + self.argument if self.argument else b"")
        mask = self.shown.mask if isinstance(self.shown, Observation) else None
        return Observation(self.shown.ints, self.shown.doubles, chars, mask=mask)


_EPISODE: Final = (
    Order("RL_INIT", b"2026", body=SPEC),
    Order("RL_START", body=BOTH),
    Order("RL_STEP", scalars=(-1.0, False), body=BOTH),
    Order("RL_AGENT_MESSAGE", b"how are you?", body=b"well"),
    Order("RL_STEP", scalars=(0.25, True), body=BOTH),
    Order("RL_RETURN", scalars=(-0.75,)),
    Order("RL_EPISODE", b"100", scalars=(True,)),
    Order("RL_NUM_EPISODES", scalars=(2,)),
    Order("RL_CLEANUP"),
)


class _Replying(Experiment):
    """A hub for our own mirror: records the request of a verb and replies."""

    def __init__(self, order: Order) -> None:
        self._order = order
        self.asked: tuple[Kind, tuple[Value, ...], bytes] | None = None

    def _call(self, kind: Kind, scalars: tuple[Value, ...] = (), body: Any = None) -> tuple[Any, Any]:
        self.asked = kind, scalars, write(body)
        return self._order.scalars, READ[CALLS[kind].reply.body](self._order.body)


class ExperimentHarness(Harness):
    """The kit as the hub of an experiment; the expected requests are those of our own mirror."""

    request: Message = Message(Kind.RL_ENV_STEP, "", 0)

    def begin(self) -> None:
        self._plot: Iterator[Order] = cycle(_EPISODE)
        self._prepared: deque[Order] = deque()
        self.request = Message(Kind.RL_ENV_STEP, self.session, -1)
        self.take(self.request._replace(body=Action(chars=b"ready").body))

    def exchanges(self) -> int:
        return 2 * len(_EPISODE)

    def with_body(self) -> Exchange:
        self.settle()
        return self.order(Order("RL_RETURN", scalars=(0.5,)))

    def prepare(self) -> Exchange:
        if self._prepared:
            return self.reply(self._prepared.popleft())
        order = next(self._plot)
        self._prepared.append(order)
        return self.order(order)

    def settle(self) -> None:
        while self._prepared:
            self.exchange()

    def order(self, order: Order) -> Exchange:
        """Return the exchange of an order for the resulting request."""
        asked = _asked(order)[0]
        reply = self.request._replace(scalars=(order.reward, False), body=order.observation.body)
        return Exchange(encode(reply, FROM_HUB), asked._replace(session=self.session))

    def reply(self, order: Order) -> Exchange:
        """Return the exchange of the reply to that request for the mirror's report of it."""
        reply = self.request._replace(scalars=order.scalars, body=order.body)
        return Exchange(encode(reply, FROM_HUB), self.showing(_asked(order)[1]))

    def showing(self, shown: AbstractType) -> Message:
        """Return the request with which the mirror reports the result of a verb."""
        return Message(Kind.RL_ENV_STEP, self.session, 0, (), shown.body)

    def do(self, *orders: Order) -> None:
        """Carry out both exchanges of each order."""
        self.settle()
        for each in orders:
            self.run(self.order(each))
            self.run(self.reply(each))

    def asks(self, order: Order) -> None:
        """Carry out the first exchange of an order."""
        self.settle()
        self.run(self.order(order))

    def welcome(self, *values: Any, **options: Any) -> None:
        super().welcome(*values, **options)
        for role in PLAYERS:
            self.send(Kind.NOTICE, Event.JOINED, role, "a mirror (the kit)")

    def ordering(self, verb: str) -> tuple[bytes, ...]:
        """Return the frames of an order that results in no request."""
        reply = self.request._replace(scalars=(0.0, False), body=Order(verb).observation.body)
        return encode(reply, FROM_HUB)

    def resume(self) -> None:
        self.take(self.request)

    def repeat(self, exchange: Exchange, frames: Sequence[bytes]) -> None:
        self.take(self.request)

    def numbered(self, expected: Message, got: Message) -> Message:
        if expected is self.request:
            return expected
        return expected._replace(seq=max(got.seq, self.request.seq + 1))

    def took(self, message: Message) -> None:
        self.request = message


def _asked(order: Order) -> tuple[Message, Action]:
    """Return the request of an order, and the mirror's report of the reply to it."""
    replying = _Replying(order)
    shown = carry_out(replying, order.verb, order.argument, order.reward, order.observation, [])
    assert replying.asked is not None
    kind, scalars, body = replying.asked
    return Message(kind, "", 0, scalars, body), shown
