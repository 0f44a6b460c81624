"""Scenes of what an experiment must understand to play at all: its requests, the values in replies."""

from __future__ import annotations

from typing import Final

import numpy as np

from glue.protocol.messages import Kind, Role
from glue.testing.conform.hub.desk import MAX_BODY
from glue.testing.conform.hub.experiment import DONE, SEEN, SPEC, ExperimentDesk, Order
from glue.testing.conform.hub.rules import Rules, Tier
from glue.testing.conform.scenes import forms
from glue.testing.conform.scenes.values import CHARS, DOUBLES, EMPTY, INTS, REWARDS, TEXTS
from glue.types import AbstractType, Observation

__all__ = ["RULES"]

RULES: Final = Rules()

_WHO: Final = (Role.EXPERIMENT,)


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
