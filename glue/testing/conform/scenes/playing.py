"""Scenes of what an agent or environment must understand to play at all: calls, and the values in them."""

from __future__ import annotations

from typing import Final

import numpy as np

from glue.protocol.messages import Role
from glue.testing.conform.hub.desk import MAX_BODY
from glue.testing.conform.hub.player import SHOWN, SPEC, PlayerDesk
from glue.testing.conform.hub.rules import PLAYERS, Rules, Tier
from glue.testing.conform.scenes import forms
from glue.testing.conform.scenes.values import CHARS, DOUBLES, EMPTY, INTS, REWARDS, TEXTS
from glue.types import Action, Observation

__all__ = ["RULES"]

RULES: Final = Rules()


@RULES.add(
    "calls", Tier.PLAYS, "what-the-calls-mean", "every call is answered, in any order that may come", PLAYERS
)
def calls(desk: PlayerDesk) -> None:
    desk.episode()
    desk.ask("MESSAGE", body=b"before any init")
    start = SHOWN.body if desk.role is Role.AGENT else b""
    init = SPEC if desk.role is Role.AGENT else b""
    for name in ("INIT", "INIT", "START", "START", "CLEANUP", "CLEANUP", "INIT", "START"):
        desk.ask(name, body=start if name == "START" else init if name == "INIT" else b"")
    desk.steps(Action(chars=b"!"), SHOWN)  # On, after the end of the episode.


@RULES.add(
    "doubles", Tier.PLAYS, "bodies", "doubles keep all their bits: negative zero, NaN, infinities", PLAYERS
)
def doubles(desk: PlayerDesk) -> None:
    desk.steps(Observation([], DOUBLES), *(Observation([], [number]) for number in DOUBLES))
    exchange = desk.step(SHOWN, reward=-0.1)  # From the header into the doubles.
    desk.send_frames(exchange.frames)
    desk.take(exchange.expected)


@RULES.add("ints", Tier.PLAYS, "bodies", "ints are 32 bits, signed, little-endian", PLAYERS)
def ints(desk: PlayerDesk) -> None:
    desk.steps(Observation(INTS))


@RULES.add("chars", Tier.PLAYS, "bodies", "chars are any bytes", PLAYERS)
def chars(desk: PlayerDesk) -> None:
    desk.steps(Observation(chars=CHARS), Observation(chars=b"\0"))


@RULES.add(
    "empty",
    Tier.PLAYS,
    "bodies",
    "any of the runs may be empty, and all of them",
    PLAYERS,
    needs=("doubles",),
)
def empty(desk: PlayerDesk) -> None:
    desk.steps(*EMPTY)


@RULES.add(
    "large", Tier.PLAYS, "bodies", "bodies may be as large as WELCOME's max_body", PLAYERS, needs=("doubles",)
)
def large(desk: PlayerDesk) -> None:
    # What the mirror adds to it: an int, and one or two doubles.
    spare = MAX_BODY - 16 - 4 - (16 if desk.role is Role.AGENT else 8)
    count = np.arange(spare // 24)
    rest = spare - 12 * len(count)
    desk.steps(Observation([7] * 70, [0.25] * 40), Observation(count, count / 7, b"\xfe" * rest))


@RULES.add(
    "texts",
    Tier.PLAYS,
    "bodies",
    "texts are UTF-8: empty, long, outside of ASCII, with NUL",
    PLAYERS,
    needs=("large",),
)
def texts(desk: PlayerDesk) -> None:
    for text in TEXTS:
        desk.ask("MESSAGE", body=text)
    if desk.role is Role.AGENT:
        for text in TEXTS:
            desk.ask("INIT", body=text)


@RULES.add("rewards", Tier.PLAYS, "the-header", "a reward may be any number", PLAYERS, needs=("doubles",))
def rewards(desk: PlayerDesk) -> None:
    for reward in REWARDS:
        if desk.role is Role.AGENT:
            desk.ask("STEP", reward, body=SHOWN.body)
            desk.ask("END", reward)
        else:
            desk.steps(Action([], [reward]))


@RULES.add(
    "widths",
    Tier.PLAYS,
    "the-header",
    "every format of msgpack is understood, in every width",
    PLAYERS,
    needs=("doubles", "rewards"),
)
def widths(desk: PlayerDesk) -> None:
    kind = int(desk.kinds["STEP"])
    fixed = [forms.float_64(0.0)] if desk.role is Role.AGENT else []
    for variant in forms.VARIANTS:
        exchange = desk.step(SHOWN)
        desk.send_frames((forms.header(kind, desk.session, desk.seq, fixed, **variant), exchange.frames[1]))
        desk.take(exchange.expected)
    for reward, form in forms.rewards() if desk.role is Role.AGENT else ():
        exchange = desk.step(SHOWN, reward)
        desk.send_frames((forms.header(kind, desk.session, desk.seq, [form]), exchange.frames[1]))
        desk.take(exchange.expected)
