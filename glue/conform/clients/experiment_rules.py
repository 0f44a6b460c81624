"""The rules for experiments: their requests, the values in the replies, and that each is carried out once."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import replace
from typing import Final

import numpy as np

from glue.conform import forms
from glue.conform.clients.connection import Gone
from glue.conform.clients.experiment_harness import BOTH, DONE, SEEN, ExperimentHarness, Order
from glue.conform.clients.harness import MAX_BODY, SPEC, Harness
from glue.conform.clients.mirror import result
from glue.conform.messages import described, same
from glue.conform.rules import Broken, NotJudged, Requirement, Rules, Tier
from glue.types import CUT_OFF, AbstractType, Action, Observation
from glue.wire.codec import FROM_HUB, encode
from glue.wire.messages import EXTRAS, MASK, OUTCOME, ErrorCode, Event, Kind, Message, Role

RULES: Final = Rules((Role.EXPERIMENT,))


@RULES.add(Tier.PLAYS, "what-the-calls-mean")
def calls(kit: ExperimentHarness) -> None:
    """Every request is made, and its reply understood."""
    kit.do(
        Order("RL_INIT", body=SPEC),
        Order("RL_INIT", b"9223372036854775807", body=b""),
        Order("RL_START", body=BOTH),
        Order("RL_STEP", scalars=(1.5, False), body=BOTH),
        Order("RL_STEP", scalars=(-1.5, True), body=BOTH),
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


@RULES.add(Tier.COMPLETE, "capabilities", level=Requirement.MAY)
def metrics(kit: ExperimentHarness) -> None:
    """The agent's metrics are understood: doubles, with a line of the chars for each name."""
    kit.do(
        Order("RL_AGENT_METRICS", body=Observation([], [0.125, -2.0], "größe\nof it".encode()).body),
        Order("RL_AGENT_METRICS", body=Observation().body),
    )


def _shows(*shown: AbstractType) -> Iterator[Order]:
    """Yield orders whose replies carry `shown`, as observations and as actions."""
    for each in shown:
        yield Order("RL_ENV_START", body=each.body)
        yield Order("RL_STEP", scalars=(0.5, False), body=each.body + DONE.body)
        yield Order("RL_START", body=SEEN.body + each.body)


@RULES.add(Tier.PLAYS, "bodies")
def ints(kit: ExperimentHarness) -> None:
    """Ints are 32 bits, signed, little-endian."""
    kit.do(
        *_shows(Observation(forms.INTS)),
        Order("RL_ENV_STEP", b"", Observation(forms.INTS), scalars=(0.0, False), body=SEEN.body),
    )


@RULES.add(Tier.PLAYS, "bodies")
def doubles(kit: ExperimentHarness) -> None:
    """Doubles keep all their bits: negative zero, NaN, infinities."""
    kit.do(
        *_shows(Observation([1], forms.DOUBLES)),
        Order("RL_AGENT_START", b"", Observation([], forms.DOUBLES), body=DONE.body),
    )


@RULES.add(Tier.PLAYS, "bodies")
def chars(kit: ExperimentHarness) -> None:
    """Chars are any bytes."""
    kit.do(*_shows(Observation([1], [], forms.CHARS)), Order("RL_AGENT_LOAD", forms.CHARS))


@RULES.add(Tier.PLAYS, "bodies")
def empty(kit: ExperimentHarness) -> None:
    """Any or all of the runs may be empty."""
    kit.do(*_shows(*forms.EMPTY))


@RULES.add(Tier.PLAYS, "bodies")
def counts(kit: ExperimentHarness) -> None:
    """Each of the runs may have more than 65,535 elements."""
    kit.do(*(Order("RL_ENV_START", body=each.body) for each in forms.MANY))


@RULES.add(Tier.PLAYS, "bodies", needs=("counts",))
def large(kit: ExperimentHarness) -> None:
    """Bodies may be as large as WELCOME's max_body."""
    spare = MAX_BODY - 16 - 8
    count = np.arange(spare // 24)
    largest = Observation(count, count / 7, b"\xfe" * (spare - 12 * len(count)))
    kit.do(*_shows(Observation([7] * 70, [0.25] * 40)), Order("RL_ENV_START", body=largest.body))


@RULES.add(Tier.PLAYS, "bodies", needs=("counts",))
def texts(kit: ExperimentHarness) -> None:
    """Texts are UTF-8: empty, long, outside of ASCII, with NUL."""
    for text in forms.TEXTS:
        kit.do(Order("RL_AGENT_MESSAGE", text, body=text), Order("RL_INIT", body=text))


@RULES.add(Tier.PLAYS, "the-header")
def rewards(kit: ExperimentHarness) -> None:
    """Rewards and returns may be any number."""
    for reward in forms.REWARDS:
        kit.do(
            Order("RL_RETURN", scalars=(reward,)),
            Order("RL_STEP", scalars=(reward, True), body=BOTH),
            Order("RL_AGENT_END", reward=reward),
        )


@RULES.add(Tier.PLAYS, "the-header")
def counters(kit: ExperimentHarness) -> None:
    """Numbers of steps and episodes go up to 2^63 - 1."""
    for number in (0, 127, 128, 2**16, 2**31, 2**32, 2**53 + 1, 2**63 - 1):
        kit.do(Order("RL_NUM_STEPS", scalars=(number,)), Order("RL_NUM_EPISODES", scalars=(number,)))


@RULES.add(Tier.PLAYS, "the-header")
def widths(kit: ExperimentHarness) -> None:
    """Every format of msgpack is understood, in every width."""
    kind = int(Kind.RL_RETURN)
    orders = [(0.5, {"scalars": [forms.float_64(0.5)], **variant}) for variant in forms.VARIANTS]
    orders += [(reward, {"scalars": [form]}) for reward, form in forms.rewards()]
    for reward, options in orders:
        order = Order("RL_RETURN", scalars=(reward,))
        kit.asks(order)
        kit.send_frames((forms.header(kind, kit.session, kit.request.seq, **options),))
        kit.take(kit.reply(order).expected)


@RULES.add(Tier.PLAYS, "the-header")
def integer_terminal(kit: ExperimentHarness) -> None:
    """Terminal may be an integer: all except 0 are true."""
    for terminal, form in forms.truths():
        order = Order("RL_STEP", scalars=(1.0, terminal), body=BOTH)
        kit.asks(order)
        header = forms.header(int(Kind.RL_STEP), kit.session, kit.request.seq, [forms.float_64(1.0), form])
        kit.send_frames((header, order.body))
        kit.take(kit.reply(order).expected)


_ONCE: Final = "calls-and-how-each-happens-exactly-once"


@RULES.add(Tier.SURVIVES, "greeting")
def silent_until_welcomed(kit: ExperimentHarness) -> None:
    """One request is sent over a new connection, after WELCOME."""
    kit.connect()
    kit.nothing("between HELLO and WELCOME")
    kit.welcome()
    kit.resume()
    kit.nothing("more: a request is sent once over each connection")


@RULES.add(Tier.SURVIVES, _ONCE)
def numbers(kit: ExperimentHarness) -> None:
    """Requests are counted from 1, each with a greater number than the one before."""
    kit.fresh()
    if kit.request.seq != 1:
        raise Broken(
            "a first request with the number 1", described(kit.request), encode(kit.request, FROM_HUB)
        )
    kit.episode()


@RULES.add(Tier.SURVIVES, _ONCE)
def other_replies(kit: ExperimentHarness) -> None:
    """A reply or an error that is not to the request under way is ignored."""
    order = Order("RL_RETURN", scalars=(2.5,))
    kit.asks(order)
    for seq in (kit.request.seq - 1, kit.request.seq + 1, 0):
        kit.send(Kind.RL_RETURN, -1.0, seq=seq)
        kit.send(Kind.ERROR, ErrorCode.BUSY, "a request is under way", seq=seq)
    kit.run(kit.reply(order))


@RULES.add(Tier.SURVIVES, "greeting")
def welcome_unasked(kit: ExperimentHarness) -> None:
    """A WELCOME that answers no HELLO changes nothing."""
    order = Order("RL_RETURN", scalars=(2.5,))
    kit.asks(order)
    for seq in (None, 2**40):
        Harness.welcome(kit, resumed=False, seq=seq)
    kit.nothing("in answer to a WELCOME that answers no HELLO")
    kit.run(kit.reply(order))


@RULES.add(Tier.SURVIVES, "greeting", needs=("silent-until-welcomed",))
def welcome_lost(kit: ExperimentHarness) -> None:
    """With nothing answered yet, the request is sent again after `resumed` false."""
    kit.fresh()
    for _ in range(2):
        kit.connect()
        kit.welcome(resumed=False)
        kit.resume()
    kit.exchange()


@RULES.add(Tier.COMPLETE, "every-kind-of-message", level=Requirement.SHOULD)
def notices(kit: ExperimentHarness) -> None:
    """Every NOTICE is reported, also during a request; unknown events do no harm."""
    _notices(kit)
    kit.send(Kind.NOTICE, Event.RETURNED, Role.AGENT, "größer (C)")
    order = Order("RL_RETURN", scalars=(1.0,))
    kit.asks(order)
    kit.send(Kind.NOTICE, Event.JOINED, Role.ENVIRONMENT, "a walk")
    kit.send(Kind.NOTICE, Event.RETURNED, Role.AGENT, "")
    kit.send(Kind.NOTICE, "event-from-the-future", "critic", "someone")
    kit.run(kit.reply(order))
    lines = [line for line in _notices(kit) if not line.startswith("event-from-the-future")]
    expected = ["returned agent größer (C)", "joined environment a walk", "returned agent "]
    if [line.strip() for line in lines] != [line.strip() for line in expected]:
        raise Broken(f"the notices {expected}", str(lines))


def _notices(kit: ExperimentHarness) -> list[str]:
    kit.do()
    kit.send_frames(kit.ordering("notices"))
    got = kit.expect("RL_ENV_STEP with the notices as chars", lambda got: got.kind is Kind.RL_ENV_STEP)
    kit.took(got)
    return Action.from_body(got.body).chars.decode(errors="replace").splitlines()


@RULES.add(Tier.COMPLETE, "errors")
def errors(kit: ExperimentHarness) -> None:
    """A request that fails reports the code and the text of its ERROR."""
    for code, text in (
        (ErrorCode.PEER_LOST, "the agent walker (C) was lost"),
        (ErrorCode.PEER_FAILED, "the environment größer: division by zero"),
        (ErrorCode.UNSUPPORTED, "the agent does not save"),
    ):
        kit.asks(Order("RL_STEP", scalars=(1.0, False), body=BOTH))
        kit.send(Kind.ERROR, code, text, seq=kit.request.seq)
        kit.take(kit.showing(result(chars=f"ERROR {code} {text}".encode())))
    kit.do(Order("RL_START", body=BOTH))


@RULES.add(Tier.COMPLETE, "capabilities", needs=("integer-terminal",), level=Requirement.MAY)
def truncate(kit: ExperimentHarness) -> None:
    """The terminal 2 says that the episode was truncated, not terminated."""
    for order in (
        Order("RL_STEP", scalars=(1.0, CUT_OFF), body=BOTH),
        Order("RL_ENV_STEP", b"xyz", DONE, scalars=(1.0, CUT_OFF), body=SEEN.body),
        Order("RL_EPISODE", b"0", scalars=(CUT_OFF,)),
    ):
        kit.asks(order)
        kit.send_frames(kit.reply(order).frames)
        _cut_off(kit, order)
    kit.do(Order("RL_STEP", scalars=(1.0, True), body=BOTH))


@RULES.add(Tier.COMPLETE, "beside-the-observation", capability=MASK)
def mask(kit: ExperimentHarness) -> None:
    """Masks are read, also before an action; an observation for the agent has the mask that it is given."""
    kit.do(*_seen(*forms.MASKED))
    for each in forms.MASKED:
        kit.do(
            Order("RL_AGENT_START", b"xyz", each, body=DONE.body),
            Order("RL_AGENT_STEP", b"xyz", each, 0.5, body=DONE.body),
        )


@RULES.add(Tier.COMPLETE, "beside-the-observation", capability=EXTRAS)
def extras(kit: ExperimentHarness) -> None:
    """Extras of every type are read, behind a mask or without one."""
    kit.do(*_seen(*forms.WITH_EXTRAS))


def _seen(*observations: Observation) -> Iterator[Order]:
    """Yield orders whose replies carry observations, alone and before an action."""
    for each in observations:
        yield Order("RL_ENV_START", body=each.body)
        yield Order("RL_ENV_STEP", b"xyz", DONE, scalars=(2.5, False), body=each.body)
        yield Order("RL_START", body=each.body + DONE.body)
        yield Order("RL_STEP", scalars=(0.5, True), body=each.body + DONE.body)


def _cut_off(kit: ExperimentHarness, order: Order) -> None:
    """Expect the result of an order to show a truncation; a client that does not know them shows an end."""
    expected = kit.reply(order).expected
    got, frames = kit.next(described(expected))
    end = replace(order, scalars=(*order.scalars[:-1], True))
    if same(kit.numbered(kit.reply(end).expected, got), got):
        kit.took(got)
        raise NotJudged("the client shows a cut-off as an end, as one may that does not know of it")
    kit.matches(expected, got, frames)


@RULES.add(Tier.COMPLETE, "capabilities", capability=OUTCOME)
def outcome(kit: ExperimentHarness) -> None:
    """The reply to RL_EPISODE may have return and number of steps, or not."""
    older = Order("RL_EPISODE", b"0", scalars=(True,))
    asked = (Order("RL_RETURN", scalars=(-2.5,)), Order("RL_NUM_STEPS", scalars=(7,)))
    kit.do(older, *asked)
    kit.asks(older)
    told_all = kit.request._replace(scalars=(True, -2.5, 7))
    kit.send_frames(encode(told_all, FROM_HUB))
    kit.take(kit.reply(older).expected)
    for order in asked:
        exchange = kit.order(order)
        kit.send_frames(exchange.frames)
        got, frames = kit.next("the numbers of RL_EPISODE's reply, or a request for them")
        if got.kind is exchange.expected.kind:
            kit.took(got)
            kit.send_frames(kit.reply(order).frames)
            got, frames = kit.next("the numbers of the reply")
        kit.matches(kit.reply(order).expected, got, frames)


@RULES.add(Tier.COMPLETE, "errors")
def unknown_kind(kit: ExperimentHarness) -> None:
    """An unknown kind does no harm, nor does an ERROR with an unknown code."""
    order = Order("RL_RETURN", scalars=(2.5,))
    kit.asks(order)
    kit.send_frames((forms.header(63, kit.session, 7, []),))
    kit.send(Kind.ERROR, "a-code-from-the-future", "for nobody in particular")
    exchange = kit.reply(order)
    kit.send_frames(exchange.frames)
    try:
        kit.take(exchange.expected)
    except Broken as broken:
        if not broken.received.startswith("ERROR 7 'unknown-kind'"):
            raise
        kit.take(exchange.expected)


@RULES.add(Tier.COMPLETE, "bodies")
def broken_text(kit: ExperimentHarness) -> None:
    """A text that is not UTF-8 does not crash the experiment."""
    for text in forms.NOT_UTF_8:
        kit.asks(Order("RL_AGENT_MESSAGE", b"?"))
        kit.send(Kind.RL_AGENT_MESSAGE, seq=kit.request.seq, body=text)
        kit.took(kit.expect("RL_ENV_STEP with some text", lambda got: got.kind is Kind.RL_ENV_STEP))
    kit.do(Order("RL_RETURN", scalars=(1.0,)))


@RULES.add(Tier.COMPLETE, "greeting", needs=("silent-until-welcomed",))
def forgotten(kit: ExperimentHarness) -> None:
    """After `resumed` false the pending request is not sent again: the experiment starts over or ends."""
    kit.exchange()
    kit.connect()
    Harness.welcome(kit, resumed=False)  # The client may be gone before any NOTICE.
    _gives_up(kit, "the request of before", lambda message: message == kit.request)


@RULES.add(Tier.COMPLETE, "greeting", needs=("silent-until-welcomed",))
def max_body(kit: ExperimentHarness) -> None:
    """A request larger than WELCOME's max_body is not sent."""
    limit = 20_000
    kit.do()
    kit.connect()
    kit.welcome(max_body=limit)
    kit.resume()
    order = Order("RL_START", body=Observation([1] * 3000).body + Action([1] * 3000).body)
    kit.asks(order)
    kit.send_frames(kit.reply(order).frames)
    _gives_up(kit, f"a body of more than {limit} bytes", lambda message: len(message.body) > limit)


def _gives_up(kit: ExperimentHarness, what: str, wrong: Callable[[Message], bool]) -> None:
    """Expect anything except one message: the client leaves, sends another message, or sends nothing."""
    with suppress(Gone):
        while (frames := kit.heard(4 * kit.quiet)) is not None:
            got = kit.decoded(frames)
            if wrong(got):
                raise Broken(f"that {what} is not sent", described(got), frames)
    kit.drop()


@RULES.add(Tier.PLAYS, "greeting", level=Requirement.SHOULD)
def end(kit: ExperimentHarness) -> None:
    """The experiment says GOODBYE before it ends."""
    kit.do()
    kit.send_frames(kit.ordering("end"))
    kit.expect("GOODBYE", lambda got: got.kind is Kind.GOODBYE)
    kit.cut()
    code = kit.client.wait(kit.wait)
    if code != 0:
        raise Broken("its end with exit code 0", f"exit code {code}")
