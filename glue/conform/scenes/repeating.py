"""Scenes of an experiment's requests: each is carried out once."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace
from typing import Any, Final

from glue.conform.hub.comparing import described, same
from glue.conform.hub.connection import Gone
from glue.conform.hub.experiment import DONE, SEEN, ExperimentHarness, Order
from glue.conform.hub.harness import Harness
from glue.conform.hub.mirror import result
from glue.conform.hub.rules import Broken, NotJudged, Requirement, Rules, Tier
from glue.conform.scenes import forms
from glue.conform.scenes.values import NOT_UTF_8
from glue.types import CUT_OFF, Action, Observation
from glue.wire.codec import FROM_HUB, encode
from glue.wire.messages import OUTCOME, ErrorCode, Event, Kind, Role

RULES: Final = Rules((Role.EXPERIMENT,))

_ONCE: Final = "calls-and-how-each-happens-exactly-once"


@RULES.add(Tier.SURVIVES, "greeting")
def silent_until_welcomed(kit: ExperimentHarness) -> None:
    """One request is sent over a new connection, after WELCOME."""
    kit.cut()
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
    exchange = kit.reply(order)
    kit.run(exchange)


@RULES.add(Tier.SURVIVES, "greeting")
def welcome_unasked(kit: ExperimentHarness) -> None:
    """A WELCOME that answers no HELLO changes nothing."""
    order = Order("RL_RETURN", scalars=(2.5,))
    kit.asks(order)
    for seq in (None, 2**40):
        Harness.welcome(kit, resumed=False, seq=seq)
    kit.nothing("in answer to a WELCOME that answers no HELLO")
    exchange = kit.reply(order)
    kit.run(exchange)


@RULES.add(Tier.SURVIVES, "greeting", needs=("silent-until-welcomed",))
def welcome_lost(kit: ExperimentHarness) -> None:
    """With nothing answered yet, the request is sent again after `resumed` false."""
    kit.fresh()
    for _ in range(2):
        kit.cut()
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
    exchange = kit.reply(order)
    kit.run(exchange)
    lines = [line for line in _notices(kit) if not line.startswith("event-from-the-future")]
    expected = ["returned agent größer (C)", "joined environment a walk", "returned agent "]
    if [line.strip() for line in lines] != [line.strip() for line in expected]:
        raise Broken(f"the notices {expected}", str(lines))


def _notices(kit: ExperimentHarness) -> list[str]:
    kit.do()
    kit.send_frames(kit.ordering("notices"))
    got, frames = kit.next("RL_ENV_STEP with the notices as chars")
    if got.kind is not Kind.RL_ENV_STEP:
        raise Broken("RL_ENV_STEP with the notices as chars", described(got), frames)
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
        kit.asks(Order("RL_STEP", scalars=(1.0, False), body=SEEN.body + DONE.body))
        kit.send(Kind.ERROR, code, text, seq=kit.request.seq)
        kit.take(kit.showing(result(chars=f"ERROR {code} {text}".encode())))
    kit.do(Order("RL_START", body=SEEN.body + DONE.body))


@RULES.add(Tier.COMPLETE, "capabilities", needs=("integer-terminal",), level=Requirement.MAY)
def truncate(kit: ExperimentHarness) -> None:
    """The terminal 2 says that the episode was truncated, not terminated."""
    both = SEEN.body + DONE.body
    for order in (
        Order("RL_STEP", scalars=(1.0, CUT_OFF), body=both),
        Order("RL_ENV_STEP", b"xyz", DONE, scalars=(1.0, CUT_OFF), body=SEEN.body),
        Order("RL_EPISODE", b"0", scalars=(CUT_OFF,)),
    ):
        kit.asks(order)
        kit.send_frames(kit.reply(order).frames)
        _cut_off(kit, order)
    kit.do(Order("RL_STEP", scalars=(1.0, True), body=both))


def _cut_off(kit: ExperimentHarness, order: Order) -> None:
    """Expect the result of an order to show a truncation; a client that does not know them shows an end."""
    expected = kit.reply(order).expected
    got, frames = kit.next(described(expected))
    end = replace(order, scalars=(*order.scalars[:-1], True))
    if same(kit.numbered(kit.reply(end).expected, got), got):
        kit.took(got)
        raise NotJudged("the client shows a cut-off as an end, as one may that does not know of it")
    kit.matches(expected, got, frames)


@RULES.add(Tier.COMPLETE, "capabilities", level=Requirement.MAY, capability=OUTCOME)
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
    for text in NOT_UTF_8:
        kit.asks(Order("RL_AGENT_MESSAGE", b"?"))
        kit.send(Kind.RL_AGENT_MESSAGE, seq=kit.request.seq, body=text)
        got, frames = kit.next("RL_ENV_STEP")
        if got.kind is not Kind.RL_ENV_STEP:
            raise Broken("RL_ENV_STEP with some text", described(got), frames)
        kit.took(got)
    kit.do(Order("RL_RETURN", scalars=(1.0,)))


@RULES.add(Tier.COMPLETE, "greeting", needs=("silent-until-welcomed",))
def forgotten(kit: ExperimentHarness) -> None:
    """After `resumed` false the pending request is not sent again: the experiment starts over or ends."""
    kit.exchange()
    kit.cut()
    kit.connect()
    Harness.welcome(kit, resumed=False)  # The client may be gone before any NOTICE.
    _gives_up(kit, "the request of before", lambda message: message == kit.request)


@RULES.add(Tier.COMPLETE, "greeting", needs=("silent-until-welcomed",))
def max_body(kit: ExperimentHarness) -> None:
    """A request larger than WELCOME's max_body is not sent."""
    limit = 20_000
    kit.do()
    kit.cut()
    kit.connect()
    kit.welcome(max_body=limit)
    kit.resume()
    order = Order("RL_START", body=Observation([1] * 3000).body + Action([1] * 3000).body)
    kit.asks(order)
    kit.send_frames(kit.reply(order).frames)
    _gives_up(kit, f"a body of more than {limit} bytes", lambda message: len(message.body) > limit)


def _gives_up(kit: ExperimentHarness, what: str, wrong: Any) -> None:
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
    got, frames = kit.next("GOODBYE")
    if got.kind is not Kind.GOODBYE:
        raise Broken("GOODBYE", described(got), frames)
    kit.cut()
    code = kit.client.wait(kit.wait)
    if code != 0:
        raise Broken("its end with exit code 0", f"exit code {code}")
