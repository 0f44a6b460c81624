"""The kit as the hub of an experiment that mirrors (docs/clients.md), and the scenes of experiments."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import cycle
from typing import Any, Final

import numpy as np

from glue.client.bodies import READ, write
from glue.core.experiment import Experiment
from glue.protocol.messages import CALLS, ErrorCode, Event, Kind, Message, Role, Value
from glue.protocol.wire import FROM_HUB, encode
from glue.testing.conform import forms
from glue.testing.conform.clients import Start
from glue.testing.conform.desk import LULL, MAX_BODY, Desk, Exchange, told
from glue.testing.conform.rules import Broken, Rules, Tier
from glue.testing.conform.values import CHARS, DOUBLES, EMPTY, INTS, NOT_UTF_8, REWARDS, TEXTS
from glue.testing.conform.wire import Gone, Listener
from glue.testing.mirror import carry_out, result
from glue.types import AbstractType, Action, Observation

__all__ = ["RULES", "ExperimentDesk"]

RULES: Final = Rules()

_WHO: Final = (Role.EXPERIMENT,)

SPEC: Final = "a task for a mirror, größer als nötig".encode()
SEEN: Final = Observation([3, 5], [0.5], b"ab")
DONE: Final = Action([7], [-0.25], b"c")


_NOTHING: Final = Observation()


@dataclass(frozen=True)
class Order:
    """What the experiment is told to do, and what the kit replies to the request that it then makes."""

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
        return Observation(self.shown.ints, self.shown.doubles, chars)


class _Replying(Experiment):
    """Stands for the hub of our own mirror, to see what a verb asks and shows."""

    def __init__(self, order: Order) -> None:
        self._order = order
        self.asked: tuple[Kind, tuple[Value, ...], bytes] | None = None

    def _call(self, kind: Kind, scalars: tuple[Value, ...] = (), body: Any = None) -> tuple[Any, Any]:
        self.asked = kind, scalars, write(body)
        return self._order.scalars, READ[CALLS[kind].reply.body](self._order.body)


class ExperimentDesk(Desk):
    """What the mirror should ask and show is what ours does; see `glue.testing.mirror`."""

    def __init__(self, role: Role, start: Start, listener: Listener, wait: float) -> None:
        super().__init__(role, start, listener, wait)
        self.request = Message(Kind.RL_ENV_STEP, "", 0)

    def begin(self) -> None:
        self._plot: Iterator[Order] = cycle(self._episode())
        self._prepared: deque[Order] = deque()
        self.request = Message(Kind.RL_ENV_STEP, self.session, -1)
        self.take(self.request._replace(body=Action(chars=b"ready").body))

    @staticmethod
    def _episode() -> list[Order]:
        return [
            Order("RL_INIT", b"2026", body=SPEC),
            Order("RL_START", body=SEEN.body + DONE.body),
            Order("RL_STEP", scalars=(-1.0, False), body=SEEN.body + DONE.body),
            Order("RL_AGENT_MESSAGE", b"how are you?", body=b"well"),
            Order("RL_STEP", scalars=(0.25, True), body=SEEN.body + DONE.body),
            Order("RL_RETURN", scalars=(-0.75,)),
            Order("RL_EPISODE", b"100", scalars=(True,)),
            Order("RL_NUM_EPISODES", scalars=(2,)),
            Order("RL_CLEANUP"),
        ]

    def exchanges(self) -> int:
        return 2 * len(self._episode())

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
        """Return the exchange of an order for the request that it asks for."""
        asked = _asked(order)[0]
        reply = self.request._replace(scalars=(order.reward, False), body=order.observation.body)
        return Exchange(encode(reply, FROM_HUB), asked._replace(session=self.session))

    def reply(self, order: Order) -> Exchange:
        """Return the exchange of the reply to that request for what the mirror shows of it."""
        reply = self.request._replace(scalars=order.scalars, body=order.body)
        return Exchange(encode(reply, FROM_HUB), self.showing(_asked(order)[1]))

    def showing(self, shown: AbstractType) -> Message:
        """Return the request with which the mirror shows what came of a verb."""
        return Message(Kind.RL_ENV_STEP, self.session, 0, (), shown.body)

    def do(self, *orders: Order) -> None:
        """Go through both exchanges of each order."""
        self.settle()
        for each in orders:
            exchange = self.order(each)
            self.send_frames(exchange.frames)
            self.take(exchange.expected)
            exchange = self.reply(each)
            self.send_frames(exchange.frames)
            self.take(exchange.expected)

    def asks(self, order: Order) -> None:
        """Go through the first exchange of an order."""
        self.settle()
        exchange = self.order(order)
        self.send_frames(exchange.frames)
        self.take(exchange.expected)

    def welcome(
        self, resumed: bool = True, heartbeat: float = 1.0, max_body: int = MAX_BODY, seq: int | None = None
    ) -> None:
        super().welcome(resumed, heartbeat, max_body, seq)
        for role in (Role.AGENT, Role.ENVIRONMENT):
            self.send(Kind.NOTICE, Event.JOINED, role, "a mirror (the kit)")

    def ordering(self, verb: str) -> tuple[bytes, ...]:
        """Return the frames of an order that is followed by no request of its own."""
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
    """Return the request that an order asks for, and what the mirror shows of the reply to it."""
    replying = _Replying(order)
    shown = carry_out(replying, order.verb, order.argument, order.reward, order.observation, [])
    assert replying.asked is not None
    kind, scalars, body = replying.asked
    return Message(kind, "", 0, scalars, body), shown


# --- Plays --------------------------------------------------------------------------------------------


@RULES.add(
    "calls", Tier.PLAYS, "what-the-calls-mean", "every request is made, and its reply understood", _WHO
)
def calls(desk: ExperimentDesk) -> None:
    both = SEEN.body + DONE.body
    desk.do(
        Order("RL_INIT", body=SPEC),
        Order("RL_INIT", b"9223372036854775807", body=b""),
        Order("RL_START", body=both),
        Order("RL_STEP", scalars=(1.5, False), body=both),
        Order("RL_STEP", scalars=(-1.5, True), body=both),
        Order("RL_EPISODE", b"0", scalars=(True,)),
        Order("RL_EPISODE", b"1000000", scalars=(False,)),
        Order("RL_RETURN", scalars=(-100.25,)),
        Order("RL_NUM_STEPS", scalars=(300,)),
        Order("RL_NUM_EPISODES", scalars=(70000,)),
        Order("RL_AGENT_MESSAGE", b"hello", body=b"agent"),
        Order("RL_ENV_MESSAGE", b"hello", body=b"environment"),
        Order("RL_CLEANUP"),
        Order("RL_ENV_START", body=SEEN.body),
        Order("RL_AGENT_START", b"xyz", SEEN, body=DONE.body),
        Order("RL_ENV_STEP", b"xyz", DONE, scalars=(2.5, True), body=SEEN.body),
        Order("RL_AGENT_STEP", b"xyz", SEEN, 0.125, body=DONE.body),
        Order("RL_AGENT_END", reward=-3.5),
        Order("RL_AGENT_SAVE", body=bytes(range(256))),
        Order("RL_AGENT_LOAD", bytes(range(33, 256))),
        Order("RL_ENV_SAVE", body=b""),
        Order("RL_ENV_LOAD", b"\xff\0\xfe"),
    )


def _shows(*shown: AbstractType) -> list[Order]:
    """Return orders whose replies bring these, as observations and as actions."""
    orders = []
    for each in shown:
        orders.append(Order("RL_ENV_START", body=each.body))
        orders.append(Order("RL_STEP", scalars=(0.5, False), body=each.body + DONE.body))
        orders.append(Order("RL_START", body=SEEN.body + each.body))
    return orders


@RULES.add("ints", Tier.PLAYS, "bodies", "ints are 32 bits, signed, little-endian", _WHO)
def ints(desk: ExperimentDesk) -> None:
    desk.do(
        *_shows(Observation(INTS)),
        Order("RL_ENV_STEP", b"", Observation(INTS), scalars=(0.0, False), body=SEEN.body),
    )


@RULES.add(
    "doubles", Tier.PLAYS, "bodies", "doubles keep all their bits: negative zero, NaN, infinities", _WHO
)
def doubles(desk: ExperimentDesk) -> None:
    desk.do(
        *_shows(Observation([1], DOUBLES)),
        Order("RL_AGENT_START", b"", Observation([], DOUBLES), body=DONE.body),
    )


@RULES.add("chars", Tier.PLAYS, "bodies", "chars are any bytes", _WHO)
def chars(desk: ExperimentDesk) -> None:
    desk.do(*_shows(Observation([1], [], CHARS)), Order("RL_AGENT_LOAD", CHARS))


@RULES.add("empty", Tier.PLAYS, "bodies", "any of the runs may be empty, and all of them", _WHO)
def empty(desk: ExperimentDesk) -> None:
    desk.do(*_shows(*EMPTY))


@RULES.add("large", Tier.PLAYS, "bodies", "bodies may be as large as WELCOME's max_body", _WHO)
def large(desk: ExperimentDesk) -> None:
    spare = MAX_BODY - 16 - 8
    count = np.arange(spare // 24)
    largest = Observation(count, count / 7, b"\xfe" * (spare - 12 * len(count)))
    desk.do(*_shows(Observation([7] * 70, [0.25] * 40)), Order("RL_ENV_START", body=largest.body))


@RULES.add("texts", Tier.PLAYS, "bodies", "texts are UTF-8: empty, long, outside of ASCII, with NUL", _WHO)
def texts(desk: ExperimentDesk) -> None:
    for text in TEXTS:
        desk.do(Order("RL_AGENT_MESSAGE", text, body=text), Order("RL_INIT", body=text))


@RULES.add("rewards", Tier.PLAYS, "the-header", "rewards and returns may be any number", _WHO)
def rewards(desk: ExperimentDesk) -> None:
    for reward in REWARDS:
        desk.do(
            Order("RL_RETURN", scalars=(reward,)),
            Order("RL_STEP", scalars=(reward, True), body=SEEN.body + DONE.body),
            Order("RL_AGENT_END", reward=reward),
        )


@RULES.add("counters", Tier.PLAYS, "the-header", "numbers of steps and episodes go up to 2^63 - 1", _WHO)
def counters(desk: ExperimentDesk) -> None:
    for number in (0, 127, 128, 2**16, 2**31, 2**32, 2**53 + 1, 2**63 - 1):
        desk.do(Order("RL_NUM_STEPS", scalars=(number,)), Order("RL_NUM_EPISODES", scalars=(number,)))


@RULES.add("widths", Tier.PLAYS, "the-header", "every format of msgpack is understood, in every width", _WHO)
def widths(desk: ExperimentDesk) -> None:
    kind = int(Kind.RL_RETURN)
    orders = [(0.5, {"scalars": [forms.float_64(0.5)], **variant}) for variant in forms.VARIANTS]
    orders += [(reward, {"scalars": [form]}) for reward, form in forms.rewards()]
    for reward, options in orders:
        order = Order("RL_RETURN", scalars=(reward,))
        desk.asks(order)
        desk.send_frames((forms.header(kind, desk.session, desk.request.seq, **options),))
        desk.take(desk.reply(order).expected)


@RULES.add(
    "integer-terminal", Tier.PLAYS, "the-header", "terminal may be an integer: all but 0 are true", _WHO
)
def integer_terminal(desk: ExperimentDesk) -> None:
    for terminal, form in forms.truths():
        order = Order("RL_STEP", scalars=(1.0, terminal), body=SEEN.body + DONE.body)
        desk.asks(order)
        header = forms.header(int(Kind.RL_STEP), desk.session, desk.request.seq, [forms.float_64(1.0), form])
        desk.send_frames((header, order.body))
        desk.take(desk.reply(order).expected)


# --- Survives -----------------------------------------------------------------------------------------

_ONCE: Final = "calls-and-how-each-happens-exactly-once"


@RULES.add(
    "silent-until-welcomed",
    Tier.SURVIVES,
    "greeting",
    "no request goes over a new connection before WELCOME, and then one",
    _WHO,
)
def silent_until_welcomed(desk: ExperimentDesk) -> None:
    desk.cut()
    desk.connect()
    desk.nothing("between HELLO and WELCOME")
    desk.welcome()
    desk.resume()
    desk.nothing("more: a request is sent once over each connection")


@RULES.add(
    "numbers",
    Tier.SURVIVES,
    _ONCE,
    "requests are counted from 1, each with a greater number than the one before",
    _WHO,
)
def numbers(desk: ExperimentDesk) -> None:
    desk.drop()
    desk.start()
    desk.connect()
    desk.welcome(resumed=False)
    desk.begin()
    if desk.request.seq != 1:
        raise Broken("a first request with the number 1", told(desk.request), encode(desk.request, FROM_HUB))
    desk.episode()


@RULES.add(
    "other-replies",
    Tier.SURVIVES,
    _ONCE,
    "a reply or an error that is not to the request under way is ignored",
    _WHO,
)
def other_replies(desk: ExperimentDesk) -> None:
    order = Order("RL_RETURN", scalars=(2.5,))
    desk.asks(order)
    for seq in (desk.request.seq - 1, desk.request.seq + 1, 0):
        desk.send(Kind.RL_RETURN, -1.0, seq=seq)
        desk.send(Kind.ERROR, ErrorCode.BUSY, "a request is under way", seq=seq)
    exchange = desk.reply(order)
    desk.send_frames(exchange.frames)
    desk.take(exchange.expected)


@RULES.add(
    "welcome-lost",
    Tier.SURVIVES,
    "greeting",
    "with nothing answered yet, the request is sent again after `resumed` false",
    _WHO,
    needs=("silent-until-welcomed",),
)
def welcome_lost(desk: ExperimentDesk) -> None:
    desk.drop()
    desk.start()
    desk.connect()
    desk.welcome(resumed=False)
    desk.begin()
    for _ in range(2):
        desk.cut()
        desk.connect()
        desk.welcome(resumed=False)
        desk.resume()
    desk.exchange()


# --- Complete -----------------------------------------------------------------------------------------


@RULES.add(
    "notices",
    Tier.COMPLETE,
    "every-kind-of-message",
    "every NOTICE arrives, also amid a request; unknown events do no harm",
    _WHO,
)
def notices(desk: ExperimentDesk) -> None:
    _notices(desk)
    desk.send(Kind.NOTICE, Event.RETURNED, Role.AGENT, "größer (C)")
    order = Order("RL_RETURN", scalars=(1.0,))
    desk.asks(order)
    desk.send(Kind.NOTICE, Event.JOINED, Role.ENVIRONMENT, "a walk")
    desk.send(Kind.NOTICE, Event.RETURNED, Role.AGENT, "")
    desk.send(Kind.NOTICE, "event-from-the-future", "critic", "someone")
    exchange = desk.reply(order)
    desk.send_frames(exchange.frames)
    desk.take(exchange.expected)
    lines = [line for line in _notices(desk) if not line.startswith("event-from-the-future")]
    expected = ["returned agent größer (C)", "joined environment a walk", "returned agent "]
    if [line.strip() for line in lines] != [line.strip() for line in expected]:
        raise Broken(f"the notices {expected}", str(lines))


def _notices(desk: ExperimentDesk) -> list[str]:
    desk.do()
    desk.send_frames(desk.ordering("notices"))
    got, frames = desk.next("RL_ENV_STEP with the notices as chars")
    if got.kind is not Kind.RL_ENV_STEP:
        raise Broken("RL_ENV_STEP with the notices as chars", told(got), frames)
    desk.took(got)
    return Action.from_body(got.body).chars.decode(errors="replace").splitlines()


@RULES.add(
    "errors", Tier.COMPLETE, "errors", "a request that fails brings the code and the text of its ERROR", _WHO
)
def errors(desk: ExperimentDesk) -> None:
    for code, text in (
        (ErrorCode.PEER_LOST, "the agent walker (C) was lost"),
        (ErrorCode.PEER_FAILED, "the environment größer: division by zero"),
        (ErrorCode.UNSUPPORTED, "the agent does not save"),
    ):
        desk.asks(Order("RL_STEP", scalars=(1.0, False), body=SEEN.body + DONE.body))
        desk.send(Kind.ERROR, code, text, seq=desk.request.seq)
        desk.take(desk.showing(result(chars=f"ERROR {code} {text}".encode())))
    desk.do(Order("RL_START", body=SEEN.body + DONE.body))


@RULES.add(
    "unknown-kind",
    Tier.COMPLETE,
    "errors",
    "a kind that it does not know does no harm, nor does an ERROR with a new code",
    _WHO,
)
def unknown_kind(desk: ExperimentDesk) -> None:
    order = Order("RL_RETURN", scalars=(2.5,))
    desk.asks(order)
    desk.send_frames((forms.header(63, desk.session, 7, []),))
    desk.send(Kind.ERROR, "a-code-from-the-future", "for nobody in particular")
    exchange = desk.reply(order)
    desk.send_frames(exchange.frames)
    try:
        desk.take(exchange.expected)
    except Broken as broken:
        if not broken.received.startswith("ERROR 7 'unknown-kind'"):
            raise
        desk.take(exchange.expected)


@RULES.add("broken-text", Tier.COMPLETE, "bodies", "a text that is not UTF-8 does not end it", _WHO)
def broken_text(desk: ExperimentDesk) -> None:
    for text in NOT_UTF_8:
        desk.asks(Order("RL_AGENT_MESSAGE", b"?"))
        desk.send(Kind.RL_AGENT_MESSAGE, seq=desk.request.seq, body=text)
        got, frames = desk.next("RL_ENV_STEP")
        if got.kind is not Kind.RL_ENV_STEP:
            raise Broken("RL_ENV_STEP with some text", told(got), frames)
        desk.took(got)
    desk.do(Order("RL_RETURN", scalars=(1.0,)))


@RULES.add(
    "forgotten",
    Tier.COMPLETE,
    "greeting",
    "after `resumed` false the pending request is not sent again: it starts over or ends",
    _WHO,
    needs=("silent-until-welcomed",),
)
def forgotten(desk: ExperimentDesk) -> None:
    desk.exchange()
    desk.cut()
    desk.connect()
    Desk.welcome(desk, resumed=False)  # It may be gone before any NOTICE.
    _gives_up(desk, "the request of before", lambda message: message == desk.request)


@RULES.add(
    "max-body",
    Tier.COMPLETE,
    "greeting",
    "a request larger than WELCOME's max_body is not sent",
    _WHO,
    needs=("silent-until-welcomed",),
)
def max_body(desk: ExperimentDesk) -> None:
    limit = 20_000
    desk.do()
    desk.cut()
    desk.connect()
    desk.welcome(max_body=limit)
    desk.resume()
    order = Order("RL_START", body=Observation([1] * 3000).body + Action([1] * 3000).body)
    desk.asks(order)
    desk.send_frames(desk.reply(order).frames)
    _gives_up(desk, f"a body of more than {limit} bytes", lambda message: len(message.body) > limit)


def _gives_up(desk: ExperimentDesk, what: str, wrong: Any) -> None:
    """Expect anything but one message: the client leaves, says something else, or nothing."""
    try:
        frames = desk.wire.receive(4 * LULL)
    except Gone:
        frames = None
    if frames is not None:
        got = desk.decoded(frames)
        if wrong(got):
            raise Broken(f"that {what} is not sent", told(got), frames)
    desk.drop()


@RULES.add("end", Tier.PLAYS, "greeting", "it says GOODBYE before it ends", _WHO)
def end(desk: ExperimentDesk) -> None:
    desk.do()
    desk.send_frames(desk.ordering("end"))
    got, frames = desk.next("GOODBYE")
    if got.kind is not Kind.GOODBYE:
        raise Broken("GOODBYE", told(got), frames)
    desk.cut()
    code = desk.client.wait(desk.wait)
    if code != 0:
        raise Broken("its end with exit code 0", f"exit code {code}")
