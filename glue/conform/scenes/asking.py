"""Scenes of the requests of an experiment, and of the values in their replies."""

from __future__ import annotations

from typing import Final

import numpy as np

from glue.conform.hub.experiment import DONE, SEEN, SPEC, ExperimentHarness, Order
from glue.conform.hub.harness import MAX_BODY
from glue.conform.hub.rules import Requirement, Rules, Tier
from glue.conform.scenes import forms
from glue.conform.scenes.values import CHARS, DOUBLES, EMPTY, INTS, MANY, REWARDS, TEXTS
from glue.types import AbstractType, Observation
from glue.wire.messages import Kind, Role

RULES: Final = Rules((Role.EXPERIMENT,))


@RULES.add(Tier.PLAYS, "what-the-calls-mean")
def calls(kit: ExperimentHarness) -> None:
    """Every request is made, and its reply understood."""
    both = SEEN.body + DONE.body
    kit.do(
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


@RULES.add(Tier.COMPLETE, "capabilities", level=Requirement.MAY)
def metrics(kit: ExperimentHarness) -> None:
    """The agent's metrics are understood: doubles, with a line of the chars for each name."""
    kit.do(
        Order("RL_AGENT_METRICS", body=Observation([], [0.125, -2.0], "größe\nof it".encode()).body),
        Order("RL_AGENT_METRICS", body=Observation().body),
    )


def _shows(*shown: AbstractType) -> list[Order]:
    """Return orders whose replies carry `shown`, as observations and as actions."""
    orders = []
    for each in shown:
        orders.append(Order("RL_ENV_START", body=each.body))
        orders.append(Order("RL_STEP", scalars=(0.5, False), body=each.body + DONE.body))
        orders.append(Order("RL_START", body=SEEN.body + each.body))
    return orders


@RULES.add(Tier.PLAYS, "bodies")
def ints(kit: ExperimentHarness) -> None:
    """Ints are 32 bits, signed, little-endian."""
    kit.do(
        *_shows(Observation(INTS)),
        Order("RL_ENV_STEP", b"", Observation(INTS), scalars=(0.0, False), body=SEEN.body),
    )


@RULES.add(Tier.PLAYS, "bodies")
def doubles(kit: ExperimentHarness) -> None:
    """Doubles keep all their bits: negative zero, NaN, infinities."""
    kit.do(
        *_shows(Observation([1], DOUBLES)),
        Order("RL_AGENT_START", b"", Observation([], DOUBLES), body=DONE.body),
    )


@RULES.add(Tier.PLAYS, "bodies")
def chars(kit: ExperimentHarness) -> None:
    """Chars are any bytes."""
    kit.do(*_shows(Observation([1], [], CHARS)), Order("RL_AGENT_LOAD", CHARS))


@RULES.add(Tier.PLAYS, "bodies")
def empty(kit: ExperimentHarness) -> None:
    """Any or all of the runs may be empty."""
    kit.do(*_shows(*EMPTY))


@RULES.add(Tier.PLAYS, "bodies")
def counts(kit: ExperimentHarness) -> None:
    """Each of the runs may have more than 65,535 elements."""
    kit.do(*(Order("RL_ENV_START", body=each.body) for each in MANY))


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
    for text in TEXTS:
        kit.do(Order("RL_AGENT_MESSAGE", text, body=text), Order("RL_INIT", body=text))


@RULES.add(Tier.PLAYS, "the-header")
def rewards(kit: ExperimentHarness) -> None:
    """Rewards and returns may be any number."""
    for reward in REWARDS:
        kit.do(
            Order("RL_RETURN", scalars=(reward,)),
            Order("RL_STEP", scalars=(reward, True), body=SEEN.body + DONE.body),
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
        order = Order("RL_STEP", scalars=(1.0, terminal), body=SEEN.body + DONE.body)
        kit.asks(order)
        header = forms.header(int(Kind.RL_STEP), kit.session, kit.request.seq, [forms.float_64(1.0), form])
        kit.send_frames((header, order.body))
        kit.take(kit.reply(order).expected)
