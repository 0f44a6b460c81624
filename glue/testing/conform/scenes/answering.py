"""Scenes of how an agent or environment answers: each call once, whatever else it is sent."""

from __future__ import annotations

from typing import Final

from glue.protocol.messages import ErrorCode, Event, Kind, Role
from glue.testing.conform.hub.comparing import described
from glue.testing.conform.hub.desk import LULL
from glue.testing.conform.hub.player import SHOWN, PlayerDesk
from glue.testing.conform.hub.rules import PLAYERS, Broken, NotJudged, Rules, Tier
from glue.testing.conform.hub.wire import Gone
from glue.testing.conform.scenes import forms
from glue.testing.conform.scenes.values import NOT_UTF_8
from glue.testing.mirror import FAIL, FAILURE
from glue.types import Action, Observation

__all__ = ["RULES"]

RULES: Final = Rules()

_ONCE: Final = "calls-and-how-each-happens-exactly-once"


@RULES.add(
    "numbers", Tier.SURVIVES, _ONCE, "the numbers of calls only grow, with gaps, up to 2^63 - 1", PLAYERS
)
def numbers(desk: PlayerDesk) -> None:
    for seq in (desk.seq + 93, 2**15, 2**16, 2**31, 2**32, 2**53 + 1, 2**53 + 2, 2**63 - 2, 2**63 - 1):
        desk.ask("MESSAGE", body=b"a gap", seq=seq)
    desk.drop()  # There is no greater number.


@RULES.add(
    "repeated",
    Tier.SURVIVES,
    _ONCE,
    "a call that comes again gets the same answer, and is not carried out again",
    PLAYERS,
)
def repeated(desk: PlayerDesk) -> None:
    for _ in range(desk.exchanges()):
        exchange = desk.prepare()
        desk.send_frames(exchange.frames)
        desk.take(exchange.expected)
        for _ in range(2):
            desk.send_frames(exchange.frames)
            desk.take(exchange.expected)
    desk.steps(SHOWN)


@RULES.add("outdated", Tier.SURVIVES, _ONCE, "a call with a number below the last is not answered", PLAYERS)
def outdated(desk: PlayerDesk) -> None:
    first = desk.step(SHOWN)
    desk.send_frames(first.frames)
    desk.take(first.expected)
    desk.steps(Observation(chars=b"8"))
    desk.send_frames(first.frames)
    desk.steps(Observation(chars=b"9"))
    desk.nothing("in answer to an outdated call")


@RULES.add(
    "silent-until-welcomed",
    Tier.SURVIVES,
    "greeting",
    "no answer goes over a new connection before WELCOME",
    PLAYERS,
)
def silent_until_welcomed(desk: PlayerDesk) -> None:
    exchange = desk.step(SHOWN)
    desk.send_frames(exchange.frames)
    frames = desk.take(exchange.expected)
    desk.cut()
    desk.connect()
    desk.nothing("between HELLO and WELCOME")
    desk.welcome()
    desk.nothing("until the call comes again")
    desk.repeat(exchange, frames)


@RULES.add(
    "forgets",
    Tier.SURVIVES,
    "greeting",
    "after `resumed` false numbers begin anew, and a number says nothing about calls before",
    PLAYERS,
    needs=("silent-until-welcomed",),
)
def forgets(desk: PlayerDesk) -> None:
    desk.steps(SHOWN, SHOWN)
    last = desk.seq
    for seq in (1, last):
        desk.cut()
        desk.connect()
        desk.welcome(resumed=False)
        # With `last`, it has the number of a call that was answered, but is another.
        desk.ask("MESSAGE", body=b"a hub that was restarted", seq=seq)
        desk.seq = last
        desk.steps(Observation(chars=b"6"))
        last = desk.seq


@RULES.add(
    "welcome-lost",
    Tier.SURVIVES,
    "greeting",
    "the very call that was answered last, after `resumed` false, gets the kept answer",
    PLAYERS,
    needs=("silent-until-welcomed",),
)
def welcome_lost(desk: PlayerDesk) -> None:
    exchange = desk.step(SHOWN)
    desk.send_frames(exchange.frames)
    desk.take(exchange.expected)
    for _ in range(2):
        desk.cut()
        desk.connect()
        desk.welcome(resumed=False)
        desk.send_frames(exchange.frames)
        desk.take(exchange.expected)
    desk.steps(SHOWN)


@RULES.add(
    "unknown-kind",
    Tier.COMPLETE,
    "errors",
    "a kind that it does not know is answered with ERROR unknown-kind",
    PLAYERS,
)
def unknown_kind(desk: PlayerDesk) -> None:
    desk.seq += 1
    desk.send_frames((forms.header(63, desk.session, desk.seq, []),))
    _error(desk, ErrorCode.UNKNOWN_KIND)
    desk.seq += 1
    desk.send_frames((forms.header(62, desk.session, desk.seq, [forms.text("a", 8)]), b"with a body"))
    _error(desk, ErrorCode.UNKNOWN_KIND)
    desk.steps(SHOWN)


def _error(desk: PlayerDesk, code: ErrorCode) -> str:
    got, frames = desk.next(f"ERROR {desk.seq} {code}")
    if (got.kind, got.session, got.seq) != (Kind.ERROR, desk.session, desk.seq) or got.scalars[0] != code:
        raise Broken(f"ERROR {desk.seq} {code!s}", described(got), frames)
    return str(got.scalars[1])


@RULES.add(
    "ignores",
    Tier.COMPLETE,
    "what-a-peer-must-should-and-may-do",
    "ERRORs and NOTICEs that mean nothing to it are ignored, and never answered",
    PLAYERS,
)
def ignores(desk: PlayerDesk) -> None:
    for code in ("not-asked", "a-code-from-the-future"):
        desk.send(Kind.ERROR, code, "for nobody in particular", seq=desk.seq)
        desk.send(Kind.NOTICE, Event.JOINED, Role.EXPERIMENT, "someone")
        desk.steps(SHOWN)
    desk.nothing("in answer to an ERROR or a NOTICE")


@RULES.add(
    "seed", Tier.COMPLETE, "capabilities", "the capability seed: any number from 0 to 2^63 - 1", PLAYERS
)
def seed(desk: PlayerDesk) -> None:
    _needs(desk, "seed")
    for number in (0, 1, 2**31, 2**53 + 1, 2**63 - 1):
        desk.ask("SEED", number)
        if "save" in desk.capabilities:
            desk.ask("SAVE")


@RULES.add("save", Tier.COMPLETE, "capabilities", "the capability save: what was saved is loaded", PLAYERS)
def save(desk: PlayerDesk) -> None:
    _needs(desk, "save")
    desk.episode()
    desk.ask("SAVE")
    for saved in (b"0 0", b"41 2026", b"1000000 9223372036854775807"):
        desk.ask("LOAD", body=saved)
        desk.ask("SAVE")
        desk.steps(SHOWN)


@RULES.add(
    "truncate",
    Tier.COMPLETE,
    "capabilities",
    "the capability truncate: an episode that is cut off has the terminal 2",
    (Role.ENVIRONMENT,),
    needs=("calls",),
)
def truncate(desk: PlayerDesk) -> None:
    _needs(desk, "truncate")
    desk.steps(*(Action(chars=chars) for chars in (b"a?", b"a!", b"?", b"a")))


def _needs(desk: PlayerDesk, capability: str) -> None:
    if capability not in desk.capabilities:
        raise NotJudged(f"the client does not offer {capability}")


@RULES.add(
    "broken-text",
    Tier.COMPLETE,
    "bodies",
    "a text that is not UTF-8 is answered, if only with ERROR",
    PLAYERS,
)
def broken_text(desk: PlayerDesk) -> None:
    for text in NOT_UTF_8:
        desk.seq += 1
        desk.send(desk.kinds["MESSAGE"], seq=desk.seq, body=text)
        got, frames = desk.next("an answer or an ERROR")
        if got.kind not in (Kind.ERROR, desk.kinds["MESSAGE"]) or got.seq != desk.seq:
            raise Broken(f"{desk.kinds['MESSAGE'].name} {desk.seq}, or ERROR", described(got), frames)
        if got.kind is Kind.ERROR and _left(desk):
            return
    desk.steps(SHOWN)


@RULES.add(
    "max-body",
    Tier.COMPLETE,
    "greeting",
    "an answer larger than WELCOME's max_body is not sent; ERROR is",
    PLAYERS,
    needs=("silent-until-welcomed",),
)
def max_body(desk: PlayerDesk) -> None:
    desk.cut()
    desk.connect()
    limit = 20_000
    desk.welcome(max_body=limit)
    exchange = desk.step(Observation([1] * 4995))
    desk.send_frames(exchange.frames)
    got, frames = desk.next("ERROR exception")
    if got.kind is not Kind.ERROR or got.scalars[0] != ErrorCode.EXCEPTION or got.seq != desk.seq:
        raise Broken(f"ERROR {desk.seq} exception, since {limit} bytes are allowed", described(got), frames)
    if not _left(desk):
        desk.cut()
        desk.reconnect()
        desk.steps(SHOWN)


@RULES.add(
    "exception",
    Tier.COMPLETE,
    "errors",
    "a player's own failure is reported with ERROR exception and its text",
    PLAYERS,
)
def exception(desk: PlayerDesk) -> None:
    desk.seq += 1
    desk.send(desk.kinds["MESSAGE"], seq=desk.seq, body=FAIL.encode())
    text = _error(desk, ErrorCode.EXCEPTION)
    if FAILURE not in text:
        raise Broken(f"the text {FAILURE!r} in ERROR exception", repr(text))
    if not _left(desk):
        desk.steps(SHOWN)


def _left(desk: PlayerDesk) -> bool:
    """Return whether the client left after an ERROR, as it may."""
    try:
        frames = desk.wire.receive(LULL)
    except Gone:
        frames = None
    else:
        if frames is None:
            return False
        desk.wire.ends(desk.wait)
    desk.cut()
    desk.client.wait(desk.wait)
    return True
