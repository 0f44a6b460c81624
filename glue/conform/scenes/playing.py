"""Scenes of the calls to an agent or environment, and of their values."""

from __future__ import annotations

from typing import Final

import numpy as np

from glue.conform.hub.harness import MAX_BODY
from glue.conform.hub.player import SHOWN, SPEC, PlayerHarness
from glue.conform.hub.rules import PLAYERS, Rules, Tier
from glue.conform.scenes import forms
from glue.conform.scenes.values import CHARS, DOUBLES, EMPTY, INTS, MANY, REWARDS, TEXTS
from glue.types import Action, Observation
from glue.wire.messages import Role

RULES: Final = Rules(PLAYERS)


@RULES.add(Tier.PLAYS, "what-the-calls-mean")
def calls(kit: PlayerHarness) -> None:
    """Every call is answered, in any legal order."""
    kit.episode()
    if not kit.mirror:
        kit.episode()
        return  # Another order may be an error in the client's task.
    kit.ask("MESSAGE", body=b"between two episodes")
    start = SHOWN.body if kit.role is Role.AGENT else b""
    init = SPEC if kit.role is Role.AGENT else b""
    for name in ("INIT", "INIT", "START", "START", "CLEANUP", "CLEANUP", "INIT", "START"):
        kit.ask(name, body=start if name == "START" else init if name == "INIT" else b"")
    kit.steps(Action(chars=b"!"), SHOWN)  # Steps continue after the end of the episode.


@RULES.add(Tier.PLAYS, "what-the-calls-mean", mirror=True)
def before_init(kit: PlayerHarness) -> None:
    """Any call may come before INIT: messages, a start, a cleanup."""
    start = SHOWN.body if kit.role is Role.AGENT else b""
    for name, body in (("MESSAGE", b"before any init"), ("START", start), ("CLEANUP", b"")):
        kit.fresh()
        kit.ask(name, body=body)
    kit.episode()


@RULES.add(Tier.PLAYS, "bodies", mirror=True)
def doubles(kit: PlayerHarness) -> None:
    """Doubles keep all their bits: negative zero, NaN, infinities."""
    kit.steps(Observation([], DOUBLES), *(Observation([], [number]) for number in DOUBLES))
    exchange = kit.step(SHOWN, reward=-0.1)  # The reward goes from the header into the doubles.
    kit.run(exchange)


@RULES.add(Tier.PLAYS, "bodies", mirror=True)
def ints(kit: PlayerHarness) -> None:
    """Ints are 32 bits, signed, little-endian."""
    kit.steps(Observation(INTS))


@RULES.add(Tier.PLAYS, "bodies", mirror=True)
def chars(kit: PlayerHarness) -> None:
    """Chars are any bytes."""
    kit.steps(Observation(chars=CHARS), Observation(chars=b"\0"))


@RULES.add(Tier.PLAYS, "bodies", needs=("doubles",), mirror=True)
def empty(kit: PlayerHarness) -> None:
    """Any or all of the runs may be empty."""
    kit.steps(*EMPTY)


@RULES.add(Tier.PLAYS, "bodies", needs=("doubles",), mirror=True)
def counts(kit: PlayerHarness) -> None:
    """Each of the runs may have more than 65,535 elements."""
    kit.steps(*MANY)


@RULES.add(Tier.PLAYS, "bodies", needs=("doubles", "counts"), mirror=True)
def large(kit: PlayerHarness) -> None:
    """Bodies may be as large as WELCOME's max_body."""
    # Room for the mirror's additions: an int, and one or two doubles.
    spare = MAX_BODY - 16 - 4 - (16 if kit.role is Role.AGENT else 8)
    count = np.arange(spare // 24)
    rest = spare - 12 * len(count)
    kit.steps(Observation([7] * 70, [0.25] * 40), Observation(count, count / 7, b"\xfe" * rest))


@RULES.add(Tier.PLAYS, "bodies", needs=("large",), mirror=True)
def texts(kit: PlayerHarness) -> None:
    """Texts are UTF-8: empty, long, outside of ASCII, with NUL."""
    for text in TEXTS:
        kit.ask("MESSAGE", body=text)
    if kit.role is Role.AGENT:
        for text in TEXTS:
            kit.ask("INIT", body=text)


@RULES.add(Tier.PLAYS, "the-header", needs=("doubles",), mirror=True)
def rewards(kit: PlayerHarness) -> None:
    """A reward may be any number."""
    for reward in REWARDS:
        if kit.role is Role.AGENT:
            kit.ask("STEP", reward, body=SHOWN.body)
            kit.ask("END", reward)
        else:
            kit.steps(Action([], [reward]))


@RULES.add(Tier.PLAYS, "the-header", needs=("doubles", "rewards"))
def widths(kit: PlayerHarness) -> None:
    """Every format of msgpack is understood, in every width."""
    for variant in forms.VARIANTS:
        exchange = kit.step(SHOWN)
        kind = int(exchange.expected.kind)
        fixed = [forms.float_64(0.0)] if kit.kinds["STEP"] == kind and kit.role is Role.AGENT else []
        kit.send_frames((forms.header(kind, kit.session, kit.seq, fixed, **variant), exchange.frames[1]))
        kit.take(exchange.expected)
    for reward, form in forms.rewards() if kit.role is Role.AGENT and kit.mirror else ():
        kind = int(kit.kinds["STEP"])
        exchange = kit.step(SHOWN, reward)
        kit.send_frames((forms.header(kind, kit.session, kit.seq, [form]), exchange.frames[1]))
        kit.take(exchange.expected)
