"""Scenes of an experiment that keeps to its requests, whatever else it receives."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Final

from glue.protocol.messages import OUTCOME, ErrorCode, Event, Kind, Role
from glue.protocol.wire import FROM_HUB, encode
from glue.testing.conform.hub.comparing import described, same
from glue.testing.conform.hub.desk import LULL, Desk
from glue.testing.conform.hub.experiment import DONE, SEEN, ExperimentDesk, Order
from glue.testing.conform.hub.rules import Broken, NotJudged, Rules, Tier
from glue.testing.conform.hub.wire import Gone
from glue.testing.conform.scenes import forms
from glue.testing.conform.scenes.values import NOT_UTF_8
from glue.testing.mirror import result
from glue.types import CUT_OFF, Action, Observation

__all__ = ["RULES"]

RULES: Final = Rules()

_WHO: Final = (Role.EXPERIMENT,)
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
    desk.welcome()
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
        raise Broken(
            "a first request with the number 1", described(desk.request), encode(desk.request, FROM_HUB)
        )
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
        raise Broken("RL_ENV_STEP with the notices as chars", described(got), frames)
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
    "truncate",
    Tier.COMPLETE,
    "capabilities",
    "the terminal 2 says that the episode was truncated, not terminated",
    _WHO,
    needs=("integer-terminal",),
)
def truncate(desk: ExperimentDesk) -> None:
    both = SEEN.body + DONE.body
    for order in (
        Order("RL_STEP", scalars=(1.0, CUT_OFF), body=both),
        Order("RL_ENV_STEP", b"xyz", DONE, scalars=(1.0, CUT_OFF), body=SEEN.body),
        Order("RL_EPISODE", b"0", scalars=(CUT_OFF,)),
    ):
        desk.asks(order)
        desk.send_frames(desk.reply(order).frames)
        _cut_off(desk, order)
    desk.do(Order("RL_STEP", scalars=(1.0, True), body=both))


def _cut_off(desk: ExperimentDesk, order: Order) -> None:
    """Expect that the result of an order shows a truncation; a client without them shows an end."""
    expected = desk.reply(order).expected
    got, frames = desk.next(described(expected))
    end = replace(order, scalars=(*order.scalars[:-1], True))
    if same(desk.numbered(desk.reply(end).expected, got), got):
        desk.took(got)
        raise NotJudged("the client shows a cut-off as an end, as one may that does not know of it")
    desk.matches(expected, got, frames)


@RULES.add(
    "outcome",
    Tier.COMPLETE,
    "capabilities",
    "the capability outcome: the reply to RL_EPISODE has return and number of steps, or not",
    _WHO,
)
def outcome(desk: ExperimentDesk) -> None:
    if OUTCOME not in desk.capabilities:
        raise NotJudged(f"the client does not offer {OUTCOME}")
    older = Order("RL_EPISODE", b"0", scalars=(True,))
    asked = (Order("RL_RETURN", scalars=(-2.5,)), Order("RL_NUM_STEPS", scalars=(7,)))
    desk.do(older, *asked)
    desk.asks(older)
    told_all = desk.request._replace(scalars=(True, -2.5, 7))
    desk.send_frames(encode(told_all, FROM_HUB))
    desk.take(desk.reply(older).expected)
    for order in asked:
        exchange = desk.order(order)
        desk.send_frames(exchange.frames)
        got, frames = desk.next("the numbers of RL_EPISODE's reply, or a request for them")
        if got.kind is exchange.expected.kind:
            desk.took(got)
            desk.send_frames(desk.reply(order).frames)
            got, frames = desk.next("the numbers of the reply")
        desk.matches(desk.reply(order).expected, got, frames)


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
            raise Broken("RL_ENV_STEP with some text", described(got), frames)
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
            raise Broken(f"that {what} is not sent", described(got), frames)
    desk.drop()


@RULES.add("end", Tier.PLAYS, "greeting", "it says GOODBYE before it ends", _WHO)
def end(desk: ExperimentDesk) -> None:
    desk.do()
    desk.send_frames(desk.ordering("end"))
    got, frames = desk.next("GOODBYE")
    if got.kind is not Kind.GOODBYE:
        raise Broken("GOODBYE", described(got), frames)
    desk.cut()
    code = desk.client.wait(desk.wait)
    if code != 0:
        raise Broken("its end with exit code 0", f"exit code {code}")
